"""The table of causes: each is said in words, and everything that lists them lists them all."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelform.cli.commands.inspection import explain
from gelform.image.background.change import ChangeSettings, gain_from_background
from gelform.result.metrics.ball import ball_gradients
from gelform.slopes.confidence import causes
from gelform.slopes.confidence.causes import (
    CAUSES,
    DIFFERENCE_FROM,
    ERROR_OF_DIFFERENCE,
    OUTLIER,
    UNSEEN,
    WALL_CONFIDENCE,
    AllAlike,
    PreparedCauses,
    outside_of_gel,
)
from gelform.slopes.gradients import STEEPEST_GEL
from kernel_agreement import assert_kernel_agrees

PAGE = Path(__file__).resolve().parents[3] / "docs" / "confidence.md"


@pytest.mark.parametrize("name", CAUSES)
def test_a_cause_is_said_in_a_sentence_and_not_of_less_than_a_press_shows_itself(name):
    """After "5 % of the frame is ": no capital, and an end. A wall is no fault, and never named."""
    assert re.fullmatch(r"[a-z].*[.?]" if name != "wall" else "", CAUSES[name].sentence)
    assert name == "compression" or CAUSES[name].named_from > 0.3
    assert [cause.color for cause in CAUSES.values()].count(CAUSES[name].color) == 1


def test_page_and_command_list_them_all_in_their_order():
    rows = re.findall(r"^\| `(\w+)` \|", PAGE.read_text(encoding="utf-8"), re.M)
    assert rows == list(CAUSES)
    listed = re.search(r"each cause: (.*?)\. With", " ".join(explain.__doc__.split()))[1].split(", ")
    assert sorted(listed) == sorted(CAUSES)


SHAPE, CLEAN, LAW = (40, 72), 0.04, 0.03
CHANGE = ChangeSettings(blur_px=1.25)  # compared with slopes 2 px away
GRAY = np.full((*SHAPE, 3), 100, np.uint8)
NO_SLOPE = np.zeros((*SHAPE, 2), np.float32)
UNSEEN_SIGMA = UNSEEN * CLEAN


def patch(box=np.s_[10:20, 30:44]):
    """A mask (H, W), True in the box."""
    mask = np.zeros(SHAPE, dtype=bool)
    mask[box] = True
    return mask


def causes_of(rest=GRAY, **changes):
    usual = {
        "full_confidence_sigma": CLEAN,
        "levels": (1.5, 1.5, 1.5),
        "slope_per_change": 1.5,
        "outside": outside_of_gel(rest),
    }
    return PreparedCauses(rest.astype(np.float32), CHANGE, **{**usual, **changes})


def raised_by(causes, gradients=NO_SLOPE, unseen=None, image=GRAY, step=None):
    """Sigma, confidence and maps of a frame whose law says LAW everywhere."""
    sigma, maps = np.full(SHAPE, LAW, np.float32), {}
    confidence = causes(gradients, sigma, unseen, image, step, maps)
    return sigma, confidence, maps


def step_of(residual, variance=4e-4):
    """Of a frame: both alike everywhere, or maps."""
    return tuple(np.broadcast_to(np.float32(one), SHAPE).copy() for one in (residual, variance))


def test_where_nothing_is_seen_the_weight_is_below_every_solver_s_floor():
    sigma, confidence, _ = raised_by(causes_of(), unseen=patch())
    np.testing.assert_allclose(sigma[patch()], np.hypot(LAW, UNSEEN_SIGMA), rtol=1e-6)
    assert 0 < confidence[patch()].max() < 1e-5
    np.testing.assert_array_equal(sigma[~patch()], np.float32(LAW))
    assert (confidence[~patch()] == 1).all()


def test_one_rule_whatever_the_cause():
    rng = np.random.default_rng(1)
    slopes = rng.uniform(-0.06, 0.06, (*SHAPE, 2)).astype(np.float32)
    image = np.clip(GRAY + rng.normal(0, 5, GRAY.shape), 0, 255).astype(np.uint8)
    residual = rng.exponential(6, SHAPE).astype(np.float32)
    step = step_of(residual, rng.uniform(1e-4, 1e-3, SHAPE))
    sigma, confidence, maps = raised_by(causes_of(), slopes, patch(), image, step)
    added = sum(np.square(maps[name].astype(float)) for name in ("wall", "outlier", "compression"))
    wanted = np.sqrt(LAW**2 + added + patch() * UNSEEN_SIGMA**2)
    np.testing.assert_allclose(sigma, wanted, rtol=1e-5)
    wall = np.minimum(np.square(maps["wall"]), CLEAN**2 / WALL_CONFIDENCE)
    weighed = np.square(sigma) - np.square(maps["wall"]) + wall
    np.testing.assert_allclose(confidence, np.minimum(CLEAN**2 / weighed, 1), rtol=1e-4)
    assert all(maps[name].any() for name in maps)


def test_asking_why_changes_nothing():
    slopes = np.random.default_rng(1).uniform(-0.5, 0.5, (*SHAPE, 2)).astype(np.float32)
    sigma = np.full(SHAPE, LAW, np.float32)
    confidence = causes_of()(slopes, sigma, patch(), GRAY, step_of(12.0))
    asked = raised_by(causes_of(), slopes, patch(), step=step_of(12.0))
    np.testing.assert_array_equal((sigma, confidence), asked[:2])


def test_a_residual_is_doubted_from_half_of_an_outlier_s():
    residual = np.linspace(0, 4 * OUTLIER, SHAPE[1])
    sigma, confidence, maps = raised_by(causes_of(), step=step_of(residual))
    wanted = STEEPEST_GEL * np.maximum(2 * residual / OUTLIER - 1, 0)
    np.testing.assert_allclose(maps["outlier"][5], wanted, atol=1e-5)
    np.testing.assert_allclose(sigma[5], np.hypot(LAW, wanted), rtol=1e-5)
    assert (sigma[:, residual <= OUTLIER / 2] == np.float32(LAW)).all()
    assert (confidence[:, residual >= 2 * OUTLIER] < 1e-3).all()  # which solvers fill from the pixels around


def test_a_wall_keeps_a_part_of_its_confidence():
    slopes = np.zeros((*SHAPE, 2), np.float32)
    slopes[:, 30:] = 5.0
    sigma, confidence, _ = raised_by(causes_of(), slopes)
    assert sigma.max() > STEEPEST_GEL
    np.testing.assert_allclose(
        confidence.min(), WALL_CONFIDENCE / (1 + WALL_CONFIDENCE * (LAW / CLEAN) ** 2), rtol=1e-3
    )


def wall(height=0.8):
    slopes = NO_SLOPE.copy()
    slopes[:, 30:32, 0] = height
    return slopes


def test_a_wall_two_pixels_wide():
    found = raised_by(causes_of(), wall())[2]["wall"]
    one_side = ERROR_OF_DIFFERENCE * (0.8 / np.sqrt(2) - DIFFERENCE_FROM)
    both = ERROR_OF_DIFFERENCE * (0.8 - DIFFERENCE_FROM)
    np.testing.assert_allclose(
        found[5, 27:35], [0, *[one_side] * 2, *[both] * 2, *[one_side] * 2, 0], rtol=1e-5
    )
    assert not found[:, [*range(28), *range(34, SHAPE[1])]].any()


@pytest.mark.parametrize("radius_px", [40.0, 60.0])
def test_a_ball_is_no_wall_up_to_its_rim(radius_px):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    slopes = ball_gradients(x, y, (36.0, 20.0), radius_px).astype(np.float32)
    _, _, maps = raised_by(causes_of(), slopes)
    assert not maps["wall"][np.hypot(x - 36, y - 20) < 0.4 * radius_px].any()


def test_nothing_is_a_wall_where_the_blur_is_unknown():
    slopes = np.random.default_rng(0).normal(0, 1, (*SHAPE, 2)).astype(np.float32)
    sigma, _, maps = raised_by(causes_of(walls=False), slopes)
    assert not maps["wall"].any()
    assert (sigma == np.float32(LAW)).all()


def test_a_wall_s_bend_takes_a_residual_for_its_own():
    """A residual's unit grows by the wall's variance: an edge over which the color is blurred is no shadow."""
    variance, residual = 0.02, 10 * OUTLIER
    _, _, maps = raised_by(causes_of(), wall(0.3), step=step_of(residual, variance))
    at_wall, beside = maps["wall"][5, 30], maps["outlier"][5, 10]
    share = residual / OUTLIER * variance / (variance + at_wall**2)
    assert 0.5 < share < 0.2 * residual / OUTLIER
    np.testing.assert_allclose(maps["outlier"][5, 30], STEEPEST_GEL * (2 * share - 1), rtol=1e-4)
    np.testing.assert_allclose(beside, STEEPEST_GEL * (2 * residual / OUTLIER - 1), rtol=1e-4)
    _, _, usual = raised_by(causes_of(), wall(0.3), step=step_of(2 * OUTLIER, variance))
    assert not usual["outlier"][:, 30:32].any()
    assert usual["outlier"][:, :28].min() > STEEPEST_GEL


def test_noise_becomes_slope_by_gain_and_worth():
    """Noise of 6 levels where 1.5 times 1.5 are usual, by the color change of a level and the slope of a change."""
    rest = np.full((*SHAPE, 3), 100, np.uint8)
    rest[:, 36:] = 50
    noise = np.random.default_rng(0).normal(0, 6, rest.shape)
    _, _, maps = raised_by(causes_of(rest), image=np.clip(rest + noise, 0, 255))
    gain = gain_from_background(rest.astype(np.float32), CHANGE).mean(axis=-1)
    wanted = 1.5 * np.sqrt(36 - 2.25**2) * gain
    np.testing.assert_allclose(maps["compression"], wanted, rtol=0.1)
    assert maps["compression"][0, 60] > 1.5 * maps["compression"][0, 10]
    unknown = raised_by(causes_of(rest, levels=None), image=np.clip(rest + noise, 0, 255))[2]
    assert not unknown["compression"].any(), "of a calibration that does not know its images' noise"


def test_an_unlit_corner_and_not_a_speck():
    background = np.full((*SHAPE, 3), 60, np.float32)
    corner = patch(np.s_[:12, :9])
    background[corner] = 5
    background[30:33, 30:33] = 2
    assert np.array_equal(outside_of_gel(background), corner)
    for unseen, wanted in ((None, corner), (patch(), corner | patch())):
        sigma, _, _ = raised_by(causes_of(background), unseen=unseen, image=background)
        np.testing.assert_array_equal(sigma > 1, wanted)


def test_unlit_is_up_to_8_levels_of_every_channel_over_25_pixels():
    background = np.full((*SHAPE, 3), 9, np.float32)
    background[5:10, 5:10] = 8
    assert np.array_equal(outside_of_gel(background), patch(np.s_[5:10, 5:10]))
    background[5, 5, 2] = 9
    assert outside_of_gel(background) is None


def explained(causes=None, image=GRAY, step=None, **frame):
    """What each cause adds to a frame."""
    causes = causes or causes_of()
    maps = raised_by(causes, image=image, step=step)[2]
    usual = dict.fromkeys(("clipped", "markers", "lost")) | {"color_change": np.zeros(GRAY.shape, np.float32)}
    return causes.maps_of(maps, np.full(SHAPE, LAW, np.float32), image, **{**usual, **frame})


def there(maps):
    return {name for name, one in maps.items() if one.any()}


def test_every_cause_has_its_map_in_the_order_that_pictures_color_them():
    assert list(explained()) == list(CAUSES)
    assert there(explained()) == set()


@pytest.mark.parametrize(
    ("color", "kind"),
    [
        ((-0.4, -0.3, -0.35), "shadow"),
        ((-0.5, 0.0, 0.0), "shadow"),  # of one light
        ((0.9, 0.7, 0.8), "specular"),
        ((0.8, -0.6, -0.5), "off_gamut"),
        ((0.4, -0.4, 0.1), "off_gamut"),
    ],
)
def test_what_the_color_change_has_in_common_names_an_outlier(color, kind):
    color_change = np.full(GRAY.shape, color, np.float32)
    found = explained(step=step_of(np.where(patch(), 3 * OUTLIER, 0)), color_change=color_change)
    assert there(found) == {kind}
    np.testing.assert_allclose(found[kind], np.where(patch(), 5 * STEEPEST_GEL, 0), rtol=1e-5)


def test_what_markers_hide_and_what_is_not_lit():
    rest = np.where(patch(np.s_[:12, :9])[..., None], np.uint8(5), GRAY)
    found = explained(causes_of(rest), image=rest, markers=patch())
    assert there(found) == {"marker", "outside"}
    np.testing.assert_array_equal(found["marker"], np.where(patch(), np.float32(UNSEEN_SIGMA), 0))
    np.testing.assert_array_equal(found["outside"] > 0, patch(np.s_[:12, :9]))


@pytest.mark.parametrize(
    ("level", "name"), [(254, "saturated"), (255, "saturated"), (0, "dark"), (2, "dark")]
)
def test_a_channel_that_is_left_out_costs_what_the_others_do_not_say(level, name):
    image, clipped = GRAY.copy(), np.zeros((*SHAPE, 3), np.uint8)
    image[patch(), 1], clipped[patch(), 1] = level, 1
    clipped[patch(np.s_[10:20, 30:34])] = 1
    found = explained(image=image, clipped=clipped)
    assert there(found) - {"compression"} == {name}
    np.testing.assert_allclose(found[name][10:20, 30:34], UNSEEN_SIGMA)
    np.testing.assert_allclose(found[name][10:20, 34:44], LAW)
    assert not found[name][~patch()].any()


def test_a_pixel_is_saturated_or_dark_not_both():
    image, clipped = GRAY.copy(), np.zeros((*SHAPE, 3), np.uint8)
    image[20, 30], image[20, 60] = (0, 100, 255), (0, 0, 0)
    saturated, dark = patch(np.s_[18:23, 28:33]), patch(np.s_[18:23, 58:63])
    clipped[saturated | dark] = 1
    found = explained(image=image, clipped=clipped)
    np.testing.assert_array_equal(found["saturated"] > 0, saturated)
    np.testing.assert_array_equal(found["dark"] > 0, dark)


@pytest.mark.parametrize(
    ("level", "name"),
    [(255, "saturated"), (240, "saturated"), (239, "inconsistent"), (128, "inconsistent"), (17, "inconsistent"),
     (16, "dark"), (0, "dark")],
)  # fmt: skip
def test_a_lost_part_is_named_by_how_bright_it_was(level, name):
    came = GRAY.copy()
    came[:, 30:] = level
    lost = patch(np.s_[:, 48:])
    found = explained(causes_of(levels=None), image=came, lost=lost)
    assert there(found) == {name}
    np.testing.assert_array_equal(found[name], np.where(lost, np.float32(UNSEEN_SIGMA), 0))


def test_where_nothing_is_stated_each_slope_counts_alike():
    sigma = np.full(SHAPE, LAW, np.float32)
    confidence = AllAlike()(NO_SLOPE, sigma, patch(), GRAY, None, None)
    np.testing.assert_array_equal(confidence, np.ones(SHAPE))
    assert (sigma == np.float32(LAW)).all()


def numpy_raise_sigma(
    gradients, residual, of_step, unseen_at, gain, sigma, confidence, walls, outliers, outlier, unseen, full, added,
    per_bend, bend_from, unknown, least, reach,
):  # fmt: skip
    """What the kernel should give, in float64."""
    height, width = sigma.shape
    square = np.zeros((height, width))
    for a, b in np.ndindex(height, width):
        for y, x in ((a - reach, b), (a + reach, b), (a, b - reach), (a, b + reach)):
            if 0 <= y < height and 0 <= x < width:
                square[a, b] += ((gradients[y, x].astype(float) - gradients[a, b]) ** 2).sum() / 2
    bend, doubt = (per_bend * np.maximum(np.sqrt(square) - bend_from, 0)) ** 2, np.zeros((height, width))
    if residual is not None:
        share = residual.astype(float) * of_step / (of_step + bend) / outlier
        doubt = np.minimum(unknown * np.maximum(2 * share - 1, 0), unseen) ** 2
    nothing = np.zeros((height, width), bool) if unseen_at is None else unseen_at
    doubt[nothing] = 0
    total = sigma.astype(float) ** 2 + bend + doubt + (added * gain) ** 2 + nothing * unseen**2
    weighed = total - bend + np.minimum(bend, full**2 / least)
    written = np.sqrt(total), np.minimum(full**2 / weighed, 1)
    return written if walls is None else (*written, np.sqrt(bend), np.sqrt(doubt))


@pytest.mark.parametrize("optional", [True, False])
@pytest.mark.parametrize("reach", [1, 4])
@pytest.mark.parametrize("shape", [SHAPE, (9, 33), (1, 1), (1, 5), (3, 1), (2, 64), (4, 65), (6, 129)])
def test_the_kernel_agrees_with_numpy(optional, reach, shape):
    rng = np.random.default_rng(0)

    def uniform(low, high):
        return rng.uniform(low, high, shape).astype(np.float32)

    arguments = [
        rng.normal(0, 0.3, (*shape, 2)).astype(np.float32),
        *((uniform(0, 300), uniform(1e-3, 0.3)) if optional else (None, None)),
        rng.uniform(size=shape) > 0.8 if optional else None,
        uniform(0.005, 0.02), uniform(0.01, 0.1), np.empty(shape, np.float32),
    ]  # fmt: skip
    numbers = 9.0, 40.0, 0.04, 3.0, 1.75, 0.1, 1.0, 0.002, reach
    maps = [np.empty(shape, np.float32) for _ in range(2)]
    assert_kernel_agrees(causes._raise_sigma, numpy_raise_sigma, *arguments, *maps, *numbers)


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
    assert causes.excess_noise(image, rest, usual_levels=usual) == pytest.approx(added, rel=0.1)
    narrow = image[:, :20].copy(), rest[:, :20].copy()
    assert causes.excess_noise(*narrow, 1.0) == 0, "too narrow for blocks"


@pytest.mark.parametrize("cut", [0, 3, 6])
def test_blocks_of_a_jpeg_wherever_it_is_cut(cut):
    image, rest = noisy(3.0)

    def added(quality):
        _, coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        cuts = (one[:, cut:].copy() for one in (cv2.imdecode(coded, cv2.IMREAD_COLOR), rest))
        return causes.excess_noise(*cuts, 3.0)

    assert added(10) > 1
    assert added(95) == 0


def test_blocks_that_are_rounded_apart_add_their_deviation():
    """Each block of 8 pixels is off by 2 levels RMS; the noise in it is the usual 1.5."""
    _, rest = noisy(0.0)
    rng = np.random.default_rng(3)
    off = np.kron(rng.normal(0, 2, (15, 22, 3)), np.ones((8, 8, 1)))[:120, :170]
    image = np.clip(np.rint(rest + off + rng.normal(0, 1.5, rest.shape)), 0, 255).astype(np.uint8)
    assert causes.excess_noise(image, rest, 1.5) == pytest.approx(2.0, rel=0.25)


@pytest.mark.parametrize("width", [9, 21, 50])
def test_jumps_agree_with_numpy(width):
    rng = np.random.default_rng(1)
    image, rest = rng.integers(0, 256, (2, 9, width, 3), dtype=np.uint8)

    def by_numpy(image, rest, work, medians, step):
        apart = image[::step].astype(int) - rest[::step]
        jumps = np.abs(np.diff(apart, axis=1)).mean(axis=(0, 2))
        return np.median(jumps[: (width - 1) // 8 * 8].reshape(-1, 8), axis=0)

    work, medians = np.empty(4 * width, np.int32), np.empty(8, np.float32)
    assert_kernel_agrees(causes._column_jumps, by_numpy, image, rest, work, medians, 4)
