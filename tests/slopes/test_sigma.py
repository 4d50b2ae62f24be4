"""The law of the slopes' standard deviation: recovered from errors of known size. The table of causes: each is said in
words, and everything that lists them lists them all. Clipped channels: which pixels they reach, and where too few
channels are left to tell a slope.
"""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelform.image.background import ChangeSettings, PreparedBackground
from gelform.slopes import sigma
from gelform.slopes.budget import CAUSES
from gelform.slopes.sigma import (
    AT_REST,
    HELD_OUT,
    LEAST_FACTOR,
    LEAST_SIGMA,
    ClippedChannels,
    SlopeSigma,
    ends_shown,
    outside_of_gel,
)
from kernel_agreement import assert_kernel_agrees
from made.images import PATCHED as SHAPE
from made.images import patch

LAW = SlopeSigma(rest=0.01, per_step=0.02, per_slope=2.0, full_confidence_sigma=0.03, correlation_px=8.0)


def errors_by(law, rest: float = 0.01, count: int = 60_000):
    """Errors whose deviation is law(|g|), and those of gel at rest."""
    rng = np.random.default_rng(0)
    pixels, at_rest = np.ones(count, HELD_OUT), np.zeros(5000, AT_REST)
    pixels["slope"] = rng.uniform(0, 0.8, count)
    pixels["error"] = law(pixels["slope"])[:, None] * rng.standard_normal((count, 2))
    at_rest["error"] = rest * rng.standard_normal((5000, 2))
    return pixels, at_rest


def changed(rows, **columns):
    """The table with other columns."""
    other = rows.copy()
    for name, values in columns.items():
        other[name] = values
    return other


def law_of(sigma, slopes):
    """Factor of a step's deviation."""
    return sigma.per_step * np.sqrt(1 + (sigma.per_slope * np.asarray(slopes)) ** 2)


def shares_within(sigma, pixels, bins):
    stated = pixels["stated"] * law_of(sigma, pixels["slope"])
    within = np.abs(pixels["error"]) < stated[:, None]
    return [within[bins == b].mean() for b in np.unique(bins)]


@pytest.mark.parametrize(("floor", "growth"), [(0.02, 0.0), (0.02, 0.1), (0.005, 0.2)])
def test_law_is_recovered(floor, growth):
    def law(slopes):
        return np.sqrt(floor**2 + (growth * slopes) ** 2)

    pixels, rest = errors_by(law)
    sigma = SlopeSigma.fit(pixels, rest, 8.0, 0.7)
    for slope in (0.1, 0.3, 0.7):
        assert law_of(sigma, slope) == pytest.approx(law(slope), rel=0.12)
    assert sigma.rest == pytest.approx(0.01, rel=0.05)
    # 95 % of the slopes are gentler.
    assert sigma.full_confidence_sigma == pytest.approx(law(0.95 * 0.8), rel=0.12)
    assert (sigma.correlation_px, sigma.correlated_share) == (8.0, 0.7)
    shares = shares_within(sigma, pixels, np.digitize(pixels["slope"], np.linspace(0, 0.8, 9)[1:-1]))
    assert min(shares) > (0.64 if floor > 0.01 else 0.55)  # within the first bin it varies by four times
    assert max(shares) < 0.76


def test_the_law_is_of_the_deviation_that_a_step_states():
    """A step that knows how its errors vary leaves nothing to the slope; one that is off by a factor is put right."""
    pixels, rest = errors_by(lambda s: 0.02 + 0.1 * s)
    true = 0.02 + 0.1 * pixels["slope"]
    for share in (1.0, 0.4):
        sigma = SlopeSigma.fit(changed(pixels, stated=share * true), rest, 8.0, 0.5)
        np.testing.assert_allclose(law_of(sigma, [0.0, 0.4, 0.8]), 1 / share, rtol=0.06)
        assert sigma.full_confidence_sigma == pytest.approx(np.quantile(true, 0.95), rel=0.05)
        assert sigma.rest == pytest.approx(0.01, rel=0.05)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_the_factor_of_solved_slopes_is_recovered(factor):
    rng = np.random.default_rng(0)
    stated = rng.uniform(0.01, 0.1, 20_000)
    errors = factor * stated[:, None] * rng.standard_normal((20_000, 2))
    assert LAW.with_solved(errors, stated).solved_factor == pytest.approx(factor, rel=0.02)
    assert LAW.with_solved(errors[:10], stated[:10]) == LAW, "too few"
    assert LAW.with_solved(0 * errors, stated).solved_factor == LEAST_FACTOR


def test_rest_that_no_press_showed_is_as_a_gentle_slope():
    pixels, none = errors_by(lambda s: 0.02 + 0 * s)[0], np.zeros(0, AT_REST)
    for stated in (1.0, 0.1):
        sigma = SlopeSigma.fit(changed(pixels, stated=stated), none, 8.0, 0.5)
        assert sigma.rest == pytest.approx(0.02, rel=0.05)
        np.testing.assert_allclose(sigma.shown, (0.4 * 0.8, 0.8 * 0.8), rtol=0.02)  # quantiles of the presses


def test_the_deviation_at_rest_has_a_part_that_grows_with_the_place_s_noise():
    rng = np.random.default_rng(1)
    pixels, rest = errors_by(lambda s: 0.02 + 0 * s)[0], np.zeros(20_000, AT_REST)
    rest["noise"] = rng.uniform(0.005, 0.05, 20_000) ** 2
    true = np.sqrt(0.01**2 + 0.3**2 * rest["noise"])[:, None]
    rest["error"] = true * rng.standard_normal((20_000, 2))
    sigma = SlopeSigma.fit(pixels, rest, 8.0, 0.5)
    assert (sigma.rest, sigma.rest_per_noise) == pytest.approx((0.01, 0.3), rel=0.06)
    alike = SlopeSigma.fit(pixels, changed(rest, error=0.02 * rest["error"] / true), 8.0, 0.5)
    assert (alike.rest, alike.rest_per_noise) == pytest.approx((0.02, 0.0), abs=2e-3, rel=0.05)


def test_no_law_is_below_what_float32_rounds_slopes_to():
    pixels, rest = (changed(one, error=0.0) for one in errors_by(lambda s: 0 * s))
    found = SlopeSigma.fit(pixels, rest, 8.0, 0.5)
    assert found.rest == found.per_step == found.full_confidence_sigma == LEAST_SIGMA


@pytest.mark.parametrize(
    "wrong", [{"shown": (0.6, 0.4)}, {"shown": (-0.1, 0.4)}, {"rest": 0.0}, {"rest_correlated_share": 1.1}]
)
def test_a_law_that_cannot_be_is_refused(wrong):
    with pytest.raises(ValueError, match=f"Expected {min(wrong)}"):
        replace(LAW, **wrong)


def test_a_few_wild_errors_do_not_widen_it():
    pixels, rest = errors_by(lambda s: 0.02 + 0.1 * s)
    wild = pixels.copy()
    wild["error"][::50] = 3.0
    spoilt, right = (SlopeSigma.fit(one, rest, 8.0, 0.5) for one in (wild, pixels))
    assert spoilt.full_confidence_sigma == pytest.approx(right.full_confidence_sigma, rel=0.1)


PAGE = Path(__file__).resolve().parents[2] / "docs" / "confidence.md"


@pytest.mark.parametrize("name", CAUSES)
def test_a_cause_is_said_in_a_sentence_and_not_of_less_than_a_press_shows_itself(name):
    """After "5 % of the frame is ": no capital, and an end. Those without a sentence are no fault of pixels."""
    wanted = r"[a-z].*[.?]" if name not in ("wall", "light", "unit") else ""
    assert re.fullmatch(wanted, CAUSES[name].sentence)
    assert name == "compression" or CAUSES[name].named_from > 0.3
    assert [cause.color for cause in CAUSES.values()].count(CAUSES[name].color) == 1


def test_the_document_lists_them_all_in_their_order():
    rows = re.findall(r"^\| `(\w+)` \|", PAGE.read_text(encoding="utf-8"), re.M)
    assert rows == list(CAUSES)


def test_unlit_is_up_to_8_levels_of_every_channel_over_25_pixels():
    background = np.full((*SHAPE, 3), 9, np.float32)
    background[5:10, 5:10], background[30:33, 30:33] = 8, 2
    assert np.array_equal(outside_of_gel(background), patch(np.s_[5:10, 5:10])), "and no speck"
    background[5, 5, 2] = 9
    assert outside_of_gel(background) is None


def noisy(levels, seed=0):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:120, :170]
    scene = 110 + 40 * np.sin(x / 30)[..., None] + 30 * np.cos(y / 25)[..., None] * np.array([1, 0.5, -1])
    rest = np.clip(scene, 0, 255).astype(np.uint8)
    image = np.clip(scene + rng.normal(0, levels, scene.shape), 0, 255).astype(np.uint8)
    return image, rest


@pytest.mark.parametrize(
    ("levels", "usual", "added"),
    [
        (3.0, 1.0, np.sqrt(3.0**2 - 1.5**2)),
        (6.0, 1.0, np.sqrt(6.0**2 - 1.5**2)),
        (1.5, 1.5, 0),
        (9.0, np.inf, 0),
    ],
)
def test_the_noise_of_single_pixels_beyond_the_usual(levels, usual, added):
    image, rest = noisy(levels)
    assert sigma.excess_noise(image, rest, usual_levels=usual) == pytest.approx(added, rel=0.1)
    narrow = image[:, :20].copy(), rest[:, :20].copy()
    assert sigma.excess_noise(*narrow, 1.0) == 0, "too narrow for blocks"


@pytest.mark.parametrize("cut", [0, 3, 6])
def test_blocks_of_a_jpeg_wherever_it_is_cut(cut):
    image, rest = noisy(3.0)

    def added(quality):
        _, coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        cuts = (one[:, cut:].copy() for one in (cv2.imdecode(coded, cv2.IMREAD_COLOR), rest))
        return sigma.excess_noise(*cuts, 3.0)

    assert added(10) > 1
    assert added(95) == 0


def test_blocks_that_are_rounded_apart_add_their_deviation():
    """Each block of 8 pixels is off by 2 levels RMS; the noise in it is the usual 1.5."""
    _, rest = noisy(0.0)
    rng = np.random.default_rng(3)
    off = np.kron(rng.normal(0, 2, (15, 22, 3)), np.ones((8, 8, 1)))[:120, :170]
    image = np.clip(np.rint(rest + off + rng.normal(0, 1.5, rest.shape)), 0, 255).astype(np.uint8)
    assert sigma.excess_noise(image, rest, 1.5) == pytest.approx(2.0, rel=0.25)


def test_jumps_agree_with_numpy():
    def by_numpy(image, rest, work, medians, step):
        apart = image[::step].astype(int) - rest[::step]
        jumps = np.abs(np.diff(apart, axis=1)).mean(axis=(0, 2))
        return np.median(jumps[: (image.shape[1] - 1) // 8 * 8].reshape(-1, 8), axis=0)

    assert_kernel_agrees(sigma._column_jumps, by_numpy)


FRAME = (41, 61)
BLURS = [0.0, 0.5, 0.6875, 1.0, 1.25, 2.5]


def gray(level=120):
    return np.full((*FRAME, 3), level, np.uint8)


def away_from(y, x):
    rows, columns = np.mgrid[: FRAME[0], : FRAME[1]]
    return np.hypot(rows - y, columns - x)


@pytest.mark.parametrize(("level", "counts"), [(0, True), (2, True), (3, False), (253, False), (254, True)])
@pytest.mark.parametrize("channel", [0, 1, 2])
def test_the_ends_of_the_range(level, counts, channel):
    image = gray()
    image[20, 30, channel] = level
    found, unseen = ClippedChannels(1.25, None, 1)(image, None)
    if not counts:
        assert found is unseen is None
        return
    assert found[20, 30].tolist() == [c == channel for c in range(3)]
    assert not unseen.any(), "two channels say enough"


@pytest.mark.parametrize("blur_px", BLURS)
def test_a_channel_is_clipped_as_far_as_its_blur_reaches(blur_px):
    """Outside it changes a color by less than 6 % of what it changes its own: the tail of a Gaussian at two sigma."""
    background, image = gray(), gray()
    image[20, 30, 1] = 255
    found = ClippedChannels(blur_px, None, 1)(image, None).channels
    assert not found[..., [0, 2]].any()
    reached = found[..., 1] > 0
    prepared = PreparedBackground(background, ChangeSettings(blur_px=blur_px))
    moved = np.abs(prepared.change(image) - prepared.change(background))[..., 1]
    assert moved[~reached].max() < 0.06 * moved.max()
    reach = np.ceil(2 * blur_px) + 1  # with what blooms
    assert reached[20, 30 - int(reach)]
    assert reached[20 + int(reach), 30]
    assert not reached[away_from(20, 30) > reach + 0.5].any()


def test_what_training_presses_showed_counts_fully():
    learnt = np.array([[False, True, False], [True, False, False]])
    found = ClippedChannels(1.25, learnt, 1)
    image = gray()
    image[10, 10], image[30, 40] = (120, 0, 120), (255, 120, 120)
    assert found(image, None) == (None, None)
    image[20, 50] = 0, 255, 120
    channels, _ = found(image, None)
    assert channels[20, 50].tolist() == [1, 1, 0]
    assert not channels[away_from(20, 50) > 5].any()


def test_two_pixels_that_miss_one_channel_each_may_leave_too_few_between_them():
    image = gray()
    image[20, 30, 0], image[20, 34, 2] = 255, 0
    channels, unseen = ClippedChannels(1.0, None, 1)(image, None)
    np.testing.assert_array_equal(unseen, channels.sum(axis=-1) == 2)
    assert unseen[20, 32]
    assert not unseen[20, [30, 34]].any()


def test_the_share_of_pixels_at_either_end():
    pixels = np.full((200, 3), 100, np.uint8)
    pixels[:20, 0], pixels[20:30, 0], pixels[:50, 2] = 2, 254, 255
    np.testing.assert_allclose(ends_shown(pixels), [[0.1, 0, 0], [0.05, 0, 0.25]])


def test_clipped_channels_agree_with_numpy():
    def by_numpy(image, low, high, clipped, dark_to, saturated_from):
        found = ((image <= dark_to) & low) | ((image >= saturated_from) & high)
        return found.astype(np.uint8) if found.any() else clipped

    assert_kernel_agrees(sigma._clipped_channels, by_numpy)
