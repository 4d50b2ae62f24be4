"""Standard deviation of a frame: the step's own, the factors of slope and place, and a model's own."""

from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest

from gelform.image.background.change import ChangeSettings, PreparedBackground
from gelform.image.background.untouched import Reference
from gelform.slopes.confidence import frame_sigma
from gelform.slopes.confidence.frame_sigma import (
    USUAL_LEVELS,
    PreparedSigma,
    UnknownSigma,
    noise_at_rest,
    with_model_sigma,
)
from gelform.slopes.confidence.slope_sigma import SlopeSigma, factor_at, law_at
from kernel_agreement import assert_kernel_agrees

LAW = SlopeSigma(
    rest=0.01,
    slopes=(0.0, 0.5, 1.0),
    sigmas=(0.02, 0.05, 0.12),
    full_confidence_sigma=0.03,
    correlation_px=8.0,
)


NOTHING = Reference(np.zeros(3, np.float32), 0.0, np.zeros(2, np.float32), None, ())  # no pixel is untouched


def gray(shape):
    return np.zeros((*shape, 3), np.float32)


def quiet(shape):
    """No noise of the image."""
    return np.zeros(shape, np.float32)


def test_a_frame():
    gradients = np.zeros((4, 5, 2), dtype=np.float32)
    gradients[1, 1], gradients[1, 2] = (0.6, 0.8), (1.2, 1.6)
    given = np.zeros((4, 5), dtype=bool)
    given[0, 4] = True
    untouched, sigma = PreparedSigma(LAW, quiet((4, 5)))(
        gray((4, 5)), gradients, NOTHING._replace(given=given)
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
    _, frame = PreparedSigma(law, quiet((30, 40)))(gray((30, 40)), gradients, NOTHING)
    y, x = (np.mgrid[:30, :40] + 0.5) / np.array([30, 40])[:, None, None]
    wanted = law_at(size, np.array(law.slopes), np.array(law.sigmas)) * factor_at(np.array(law.place), x, y)
    np.testing.assert_allclose(frame, wanted, rtol=0.02)


def test_the_step_s_deviation_is_what_the_factors_are_of():
    """But for untouched gel, which has a deviation of its own."""
    rng = np.random.default_rng(2)
    gradients = rng.uniform(-0.5, 0.5, (30, 40, 2)).astype(np.float32)
    variance = rng.uniform(1e-4, 4e-2, (30, 40)).astype(np.float32)
    given = rng.uniform(size=(30, 40)) < 0.3
    prepared, reference = PreparedSigma(LAW, quiet((30, 40))), NOTHING._replace(given=given)
    _, factors = prepared(gray((30, 40)), gradients.copy(), reference)
    _, sigma = prepared(gray((30, 40)), gradients.copy(), reference, variance=variance)
    np.testing.assert_allclose(sigma[~given], (factors * np.sqrt(variance))[~given], rtol=1e-5)
    np.testing.assert_allclose(sigma[given], LAW.rest, rtol=1e-6)


def test_the_bias_is_subtracted_and_hidden_pixels_are_left_out():
    gradients = np.full((3, 4, 2), 0.25, dtype=np.float32)
    reference = NOTHING._replace(bias=np.array([0.25, 0.5], np.float32), threshold=0.1)
    hidden = np.zeros((3, 4), dtype=bool)
    hidden[1, 2] = True
    for prepared in (PreparedSigma(LAW, quiet((3, 4))), UnknownSigma(0.04)):
        found = gradients.copy()
        untouched, _ = prepared(gray((3, 4)), found, reference, hidden)
        np.testing.assert_array_equal(found, np.broadcast_to(np.float32([0, -0.25]), (3, 4, 2)))
        np.testing.assert_array_equal(untouched, ~hidden)


def test_where_nobody_knows_every_slope_counts_alike():
    gradients = np.random.default_rng(0).normal(size=(3, 4, 2)).astype(np.float32)
    given = np.eye(3, 4, dtype=bool)
    untouched, sigma = UnknownSigma(0.04)(gray((3, 4)), gradients, NOTHING._replace(given=given))
    np.testing.assert_array_equal(sigma, np.full((3, 4), np.float32(0.04)))
    np.testing.assert_array_equal(untouched, given)
    variance = np.full((3, 4), 9.0, np.float32)
    _, same = UnknownSigma(0.04)(gray((3, 4)), gradients, NOTHING._replace(given=given), None, variance)
    np.testing.assert_array_equal(same, sigma)


def numpy_frame_sigma(
    change, hidden, given, common, bias, rest, place, law, variance, gradients, untouched, sigma, square, steps, grows,
    highest,
):  # fmt: skip
    """What the kernel should give, in float64."""
    near = ((change - common) ** 2).sum(axis=-1) < square
    near = given if given is not None else near & (True if hidden is None else ~hidden)
    slopes = gradients.astype(float) - bias
    size2 = (slopes**2).sum(axis=-1)
    at = np.sqrt(size2) * steps
    factor = np.where(at <= len(law) - 2, np.interp(at, np.arange(len(law)), law), grows * size2) * place
    return slopes, near, np.sqrt(np.where(near, rest, factor * (1 if variance is None else variance)))


@pytest.mark.parametrize("shape", [(1, 1), (7, 9), (1, 64), (24, 40)])
@pytest.mark.parametrize("optional", ["nothing", "hidden", "given"])
def test_the_kernels_agree_with_numpy(shape, optional):
    rng = np.random.default_rng(0)
    prepared = PreparedSigma(LAW, quiet(shape))
    change = rng.normal(0, 0.3, (*shape, 3)).astype(np.float32)
    mask = rng.uniform(size=shape) > 0.7
    masks = (mask if optional == "hidden" else None), (mask if optional == "given" else None)
    where = change, *masks, np.float32([0.02, 0, 0]), np.float32([0.01, -0.02])
    gradients = rng.normal(0, 0.5, (*shape, 2)).astype(np.float32)
    outputs, square = (np.empty(shape, bool), np.empty(shape, np.float32)), 0.3**2
    rest = rng.uniform(1e-5, 1e-3, shape).astype(np.float32)
    law = rest, prepared._place * rng.uniform(0.5, 2, shape).astype(np.float32), prepared._law
    for variance in (rng.uniform(1e-4, 1e-2, shape).astype(np.float32), None):
        assert_kernel_agrees(
            frame_sigma._frame_sigma, numpy_frame_sigma, *where, *law, variance, gradients, *outputs, square,
            *prepared._numbers.values(),
        )  # fmt: skip
    arguments = *where, gradients, outputs[0], square, 1e15
    assert_kernel_agrees(frame_sigma._subtract_bias, numpy_subtract_bias, *arguments)


def numpy_subtract_bias(change, hidden, given, common, bias, gradients, untouched, square, highest):
    near = ((change - common) ** 2).sum(axis=-1) < square
    return gradients - bias, given if given is not None else near & (True if hidden is None else ~hidden)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e16])
@pytest.mark.parametrize("component", [0, 1])
def test_slopes_that_no_sum_can_hold_are_refused(wrong, component):
    gradients = np.zeros((5, 31, 2), np.float32)
    gradients[4, 30, component] = wrong
    for prepared in (PreparedSigma(LAW, quiet((5, 31))), UnknownSigma(0.04)):
        with pytest.raises(ValueError, match="Expected slopes up to 1e"):
            prepared(gray((5, 31)), gradients.copy(), NOTHING)


def test_of_two_deviations_the_larger_counts():
    sigma, confidence = np.full((2, 2), 0.05, np.float32), np.full((2, 2), 0.8, np.float32)
    own = np.full((2, 2, 2), 0.01, np.float32)
    own[0, 0] = 0.02, 0.3
    both, found = with_model_sigma(sigma, confidence, own, full_confidence_sigma=0.03)
    np.testing.assert_allclose(both[0, 0], [0.05, 0.3])
    np.testing.assert_allclose(both[1, 1], 0.05)
    np.testing.assert_allclose(found, [[0.01, 0.8], [0.8, 0.8]], rtol=1e-6)
    alone, _ = with_model_sigma(None, confidence, own, full_confidence_sigma=0.03)
    assert alone is own
    alike, same = with_model_sigma(sigma, confidence, None, full_confidence_sigma=0.03)
    assert alike.shape == (2, 2, 2)
    assert same is confidence
    assert with_model_sigma(None, confidence, None, full_confidence_sigma=0.03)[0] is None


def linear(matrix):
    """Slopes from a color change by a fixed matrix (3, 2)."""
    matrix = np.array(matrix, np.float32)
    return SimpleNamespace(gradients_from_color=lambda change: (change @ matrix, None))


MODEL = linear([[1, 0], [0.3, 2], [0, 0.5]])


def untouched(background):
    return PreparedBackground(background.astype(np.float32), ChangeSettings(method="divide", offset=10.0))


def test_it_is_that_of_many_noisy_images():
    x = np.linspace(60, 200, 96)
    background = np.stack([np.tile(x, (64, 1)), np.tile(x[::-1], (64, 1)), np.full((64, 96), 90.0)], axis=-1)
    levels, rng, prepared = (1.0, 3.0, 2.0), np.random.default_rng(0), untouched(background)
    slopes = [
        MODEL.gradients_from_color(prepared.change(background + rng.normal(0, levels, background.shape)))[0]
        for _ in range(60)
    ]
    found = noise_at_rest(MODEL, prepared, levels)
    inner = slice(16, -16)  # the map is smooth over 8 px
    variance = np.mean(np.square(slopes), axis=(0, 1, 3))
    np.testing.assert_allclose(found[32, inner], variance[inner], rtol=0.2)
    assert found.dtype == np.float32


def test_noise_of_the_levels_is_taken_to_be_alike_where_it_is_unknown():
    prepared = untouched(np.random.default_rng(0).uniform(60, 200, (40, 50, 3)))
    alike = noise_at_rest(MODEL, prepared, (USUAL_LEVELS,) * 3)
    np.testing.assert_array_equal(noise_at_rest(MODEL, prepared, None), alike)


def test_gel_at_rest_has_the_deviation_of_its_place():
    noise = np.linspace(1e-4, 9e-4, 20, dtype=np.float32).reshape(4, 5)
    law, rest = replace(LAW, rest_per_noise=0.5), np.ones((4, 5), bool)
    _, sigma = PreparedSigma(law, noise)(
        gray((4, 5)), np.zeros((4, 5, 2), np.float32), NOTHING._replace(given=rest)
    )
    np.testing.assert_allclose(sigma, np.sqrt(0.01**2 + 0.25 * noise), rtol=1e-5)
