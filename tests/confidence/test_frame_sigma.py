"""Standard deviation of a frame: the law, colours never seen, a model's own, and what a surface leaves of it."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from gelform.background.untouched import Reference
from gelform.color_models._shared.gamut import Gamut
from gelform.confidence import frame_sigma
from gelform.confidence.frame_sigma import (
    UNLEARNT,
    PreparedSigma,
    UnknownSigma,
    with_model_sigma,
)
from gelform.confidence.slope_sigma import SlopeSigma
from kernel_agreement import assert_kernel_agrees

LAW = SlopeSigma(rest=0.01, slopes=(0.0, 0.5, 1.0), sigmas=(0.02, 0.05, 0.12), clean=0.03, correlation_px=8.0)


NOTHING = Reference(np.zeros(3, np.float32), 0.0, np.zeros(2, np.float32), None, ())  # no pixel is untouched


def grey(shape):
    return np.zeros((*shape, 3), np.float32)


def test_a_frame():
    gradients = np.zeros((4, 5, 2), dtype=np.float32)
    gradients[1, 1], gradients[1, 2] = (0.6, 0.8), (1.2, 1.6)
    given = np.zeros((4, 5), dtype=bool)
    given[0, 4] = True
    untouched, sigma = PreparedSigma(LAW, (4, 5), None)(
        grey((4, 5)), gradients, NOTHING._replace(given=given)
    )
    np.testing.assert_array_equal(untouched, given)
    assert sigma.shape == (4, 5)
    assert sigma[0, 0] == pytest.approx(0.02)
    assert sigma[0, 4] == pytest.approx(0.01)
    assert sigma[1, 1] == pytest.approx(0.12, rel=1e-2)
    assert sigma[1, 2] == pytest.approx(0.24, rel=1e-2)  # beyond the last knot in proportion


def test_frames_and_scattered_pixels_agree():
    law = SlopeSigma.from_dict({**asdict(LAW), "place": [[1.0, 2.0, 0.5, 1.0]] * 2 + [[3.0, 1.0, 1.0, 1.0]]})
    gradients = np.random.default_rng(1).uniform(-0.5, 0.5, (30, 40, 2)).astype(np.float32)
    size = np.linalg.norm(gradients, axis=-1)
    _, frame = PreparedSigma(law, (30, 40), None)(grey((30, 40)), gradients, NOTHING)
    y, x = (np.mgrid[:30, :40] + 0.5) / np.array([30, 40])[:, None, None]
    np.testing.assert_allclose(frame, law.of(size, x, y), rtol=0.02)


def test_the_bias_is_subtracted_and_hidden_pixels_are_left_out():
    gradients = np.full((3, 4, 2), 0.25, dtype=np.float32)
    reference = NOTHING._replace(bias=np.array([0.25, 0.5], np.float32), threshold=0.1)
    hidden = np.zeros((3, 4), dtype=bool)
    hidden[1, 2] = True
    for prepared in (PreparedSigma(LAW, (3, 4), None), UnknownSigma(0.04)):
        found = gradients.copy()
        untouched, _ = prepared(grey((3, 4)), found, reference, hidden)
        np.testing.assert_array_equal(found, np.broadcast_to(np.float32([0, -0.25]), (3, 4, 2)))
        np.testing.assert_array_equal(untouched, ~hidden)


def test_where_nobody_knows_every_slope_counts_alike():
    gradients = np.random.default_rng(0).normal(size=(3, 4, 2)).astype(np.float32)
    given = np.eye(3, 4, dtype=bool)
    untouched, sigma = UnknownSigma(0.04)(grey((3, 4)), gradients, NOTHING._replace(given=given))
    np.testing.assert_array_equal(sigma, np.full((3, 4), np.float32(0.04)))
    np.testing.assert_array_equal(untouched, given)


def test_colours_beyond_the_training_presses_are_not_trusted():
    gamut = seen_gamut()
    change = np.zeros((2, 3, 3), dtype=np.float32)
    change[0, 1], change[0, 2], change[1, 0] = (0.25, 0, 0), (0.5, 0, 0), (5.0, 0, 0)
    away = gamut.distance_of(change)
    _, sigma = PreparedSigma(LAW, (2, 3), gamut)(change, np.zeros((2, 3, 2), np.float32), NOTHING)
    np.testing.assert_allclose(sigma, np.hypot(0.02, away), rtol=1e-5)
    assert sigma[1, 0] > 1 > 0.03 > sigma[0, 1]


def test_slopes_steeper_than_the_presses_showed_there_are_not_trusted():
    law = replace(LAW, steepest=((0.2, 0.8),))
    gradients = np.zeros((2, 8, 2), dtype=np.float32)
    gradients[..., 1] = 0.5
    _, sigma = PreparedSigma(law, (2, 8), None)(grey((2, 8)), gradients, NOTHING)
    at_half = 0.05  # the law's
    np.testing.assert_allclose(sigma[:, 0], UNLEARNT * 0.5 * (0.5 / 0.2 - 1), rtol=1e-5)
    np.testing.assert_allclose(sigma[:, -1], at_half, rtol=1e-2)
    assert sigma[0, 0] > sigma[0, 3] >= sigma[0, 5] >= sigma[0, -1]
    _, before = PreparedSigma(LAW, (2, 8), None)(grey((2, 8)), gradients, NOTHING)
    np.testing.assert_allclose(before, at_half, rtol=1e-2)


def seen_gamut():
    seen = np.random.default_rng(2).uniform(-0.3, 0.3, (20_000, 3)).astype(np.float32)
    return Gamut.fit(seen, 2 * seen[:, :2])


def numpy_frame_sigma(
    change, hidden, given, common, bias, place, per_steepest, law, gamut, low, gradients, untouched, sigma, square,
    steps, grows, rest, bins_per_change, worth, unlearnt, highest,
):  # fmt: skip
    """What the kernel should give, in float64."""
    near = ((change - common) ** 2).sum(axis=-1) < square
    near = given if given is not None else near & (True if hidden is None else ~hidden)
    slopes = gradients.astype(float) - bias
    size2 = (slopes**2).sum(axis=-1)
    at = np.sqrt(size2) * steps
    last = len(law) - 2
    variance = np.where(at <= last, np.interp(at, np.arange(len(law)), law), grows * size2) * place
    least = unlearnt * np.sqrt(size2) * np.maximum(np.sqrt(size2) * per_steepest - 1, 0)
    variance = np.where(near, rest, np.maximum(variance, least**2))
    if gamut is not None:
        bins = (change.astype(float) - low) * bins_per_change
        inside = np.clip(bins, 0, len(gamut) - 1)
        nearest = tuple(np.moveaxis((inside + 0.5).astype(int), -1, 0))
        variance += (gamut[nearest] + worth * np.linalg.norm(bins - inside, axis=-1)) ** 2
    return slopes, near, np.sqrt(variance)


@pytest.mark.parametrize("shape", [(1, 1), (7, 9), (24, 40)])
@pytest.mark.parametrize("with_gamut", [True, False])
@pytest.mark.parametrize("optional", ["nothing", "hidden", "given"])
def test_the_kernel_agrees_with_numpy(shape, with_gamut, optional):
    rng = np.random.default_rng(0)
    prepared = PreparedSigma(LAW, shape, seen_gamut() if with_gamut else None)
    change = rng.normal(0, 0.3, (*shape, 3)).astype(np.float32)
    mask = rng.uniform(size=shape) > 0.7
    assert_kernel_agrees(
        frame_sigma._frame_sigma, numpy_frame_sigma, change, mask if optional == "hidden" else None,
        mask if optional == "given" else None, np.float32([0.02, 0, 0]), np.float32([0.01, -0.02]), prepared._place,
        rng.uniform(0.5, 2, shape).astype(np.float32), prepared._law, prepared._gamut, prepared._gamut_low,
        rng.normal(0, 0.5, (*shape, 2)).astype(np.float32), np.empty(shape, bool), np.empty(shape, np.float32), 0.3**2,
        *prepared._numbers, *prepared._gamut_numbers, 0.3, 1e15,
    )  # fmt: skip


def numpy_subtract_bias(change, hidden, given, common, bias, gradients, untouched, square, highest):
    near = ((change - common) ** 2).sum(axis=-1) < square
    return gradients - bias, given if given is not None else near & (True if hidden is None else ~hidden)


@pytest.mark.parametrize("shape", [(1, 1), (7, 9), (24, 40)])
@pytest.mark.parametrize("optional", ["nothing", "hidden", "given"])
def test_the_kernel_without_a_law_agrees_with_numpy(shape, optional):
    rng = np.random.default_rng(0)
    change = rng.normal(0, 0.3, (*shape, 3)).astype(np.float32)
    mask = rng.uniform(size=shape) > 0.7
    assert_kernel_agrees(
        frame_sigma._subtract_bias, numpy_subtract_bias, change, mask if optional == "hidden" else None,
        mask if optional == "given" else None, np.float32([0.02, 0, 0]), np.float32([0.01, -0.02]),
        rng.normal(0, 0.5, (*shape, 2)).astype(np.float32), np.empty(shape, bool), 0.3**2, 1e15,
    )  # fmt: skip


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e16])
@pytest.mark.parametrize("component", [0, 1])
def test_slopes_that_no_sum_can_hold_are_refused(wrong, component):
    gradients = np.zeros((5, 31, 2), np.float32)
    gradients[4, 30, component] = wrong
    for prepared in (PreparedSigma(LAW, (5, 31), None), UnknownSigma(0.04)):
        with pytest.raises(ValueError, match="Expected slopes up to 1e"):
            prepared(grey((5, 31)), gradients.copy(), NOTHING)


def test_of_two_deviations_the_larger_counts():
    sigma, confidence = np.full((2, 2), 0.05, np.float32), np.full((2, 2), 0.8, np.float32)
    own = np.full((2, 2, 2), 0.01, np.float32)
    own[0, 0] = 0.02, 0.3
    both, found = with_model_sigma(sigma, confidence, own, clean=0.03)
    np.testing.assert_allclose(both[0, 0], [0.05, 0.3])
    np.testing.assert_allclose(both[1, 1], 0.05)
    np.testing.assert_allclose(found, [[0.01, 0.8], [0.8, 0.8]], rtol=1e-6)
    alone, _ = with_model_sigma(None, confidence, own, clean=0.03)
    assert alone is own
    alike, same = with_model_sigma(sigma, confidence, None, clean=0.03)
    assert alike.shape == (2, 2, 2)
    assert same is confidence
    assert with_model_sigma(None, confidence, None, clean=0.03)[0] is None
