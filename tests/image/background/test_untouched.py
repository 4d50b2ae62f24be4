"""Untouched pixels: whatever the exposure, never none, and the slopes' bias read from them."""

import numpy as np
import pytest

from gelform.foundations.filters import MIN_UNTOUCHED
from gelform.image.background import untouched as untouched_pixels
from gelform.image.background.change import color_change_from_image
from gelform.image.background.untouched import reference_from_color_change
from kernel_agreement import assert_kernel_agrees
from made.touched_images import scene, touched

SHAPE = (40, 60)


def test_untouched_ignores_an_exposure_step():
    rest = scene()
    change = color_change_from_image(np.clip(touched(rest) * 1.05, 0, 255), rest)
    common = reference_from_color_change(
        change, np.zeros((*rest.shape[:2], 2), np.float32), 0.05
    ).common_change
    away = np.linalg.norm(change - common, axis=-1)
    assert away[:15].max() < 0.05 < away[22:38, 32:48].min()


def change_where(share):
    """A color change of 0.2 on a share of the frame's rows, noise of 0.01 elsewhere."""
    change = np.random.default_rng(0).normal(0, 0.01, (*SHAPE, 3)).astype(np.float32)
    change[: round(share * SHAPE[0])] += np.array([0.2, -0.2, 0.1], dtype=np.float32)
    return change


FLAT = np.zeros((*SHAPE, 2), dtype=np.float32)


def test_the_common_change_is_that_of_most_pixels():
    reference = reference_from_color_change(change_where(0.25) + np.float32(0.05), FLAT, 0.1)
    np.testing.assert_allclose(reference.common_change, 0.05, atol=0.02)
    assert reference.given is None
    assert reference.findings == ()


def test_where_everything_is_touched_the_least_changed_stand_in():
    ramp = np.linspace(-0.5, 0.5, SHAPE[1], dtype=np.float32)[None, :, None]
    change = np.broadcast_to(ramp, (*SHAPE, 3)) + np.float32(0.6)
    reference = reference_from_color_change(change, FLAT, 1e-6)
    (finding,) = reference.findings
    assert finding.name == "few_untouched"
    assert finding.figure < MIN_UNTOUCHED
    assert reference.given.mean() == pytest.approx(MIN_UNTOUCHED, abs=1 / SHAPE[1])
    assert reference.given[:, 0].all()  # 0.1 is the least change


def test_hidden_pixels_have_no_say():
    """Everything but a corner is touched, and markers hide the corner."""
    change = np.random.default_rng(2).uniform(-1, 1, (*SHAPE, 3)).astype(np.float32)
    change[30:, 40:] = 0
    hidden = np.zeros(SHAPE, dtype=bool)
    assert reference_from_color_change(change, FLAT, 0.2, hidden).given is None
    hidden[30:, 40:] = True
    assert reference_from_color_change(change, FLAT, 0.2, hidden).given is not None


@pytest.mark.parametrize("shape", [(40, 60), (41, 61), (480, 640)])
def test_the_bias_is_the_median_slope_of_the_untouched(shape):
    gradients = np.random.default_rng(1).normal(0, 0.02, (*shape, 2)).astype(np.float32)
    gradients += np.array([0.05, -0.03], dtype=np.float32)
    change = np.zeros((*shape, 3), dtype=np.float32)
    touched_rows = shape[0] // 3
    change[:touched_rows], gradients[:touched_rows] = 0.5, 2.0
    bias = reference_from_color_change(change, gradients, 0.1).bias
    np.testing.assert_allclose(bias, np.median(gradients[touched_rows:], axis=(0, 1)), atol=2e-3)
    if shape[0] * shape[1] < 5000:  # no lattice is needed
        np.testing.assert_allclose(bias, np.median(gradients[touched_rows:], axis=(0, 1)), rtol=1e-6)


@pytest.mark.parametrize("step", [1, 4])
@pytest.mark.parametrize("hidden", [None, np.arange(40 * 60).reshape(SHAPE) % 3 == 0])
def test_the_kernel_finds_what_numpy_finds(step, hidden):
    change = np.random.default_rng(4).normal(0.1, 0.05, (*SHAPE, 3)).astype(np.float32)

    def near(change, hidden, common, out, square, step):
        found = np.square(change - common).sum(axis=-1) < square
        if hidden is not None:
            found &= ~hidden
        out[::step, ::step] = found[::step, ::step]
        return out

    common = np.full(3, 0.1, np.float32)
    arguments = change, hidden, common, np.zeros(SHAPE, bool), 0.007, step
    assert_kernel_agrees(untouched_pixels._near_common, near, *arguments)
