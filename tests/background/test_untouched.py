"""Untouched pixels: whatever the exposure, never none, and the slopes' bias read from them."""

import numpy as np
import pytest

from gelform.background.change import color_change_from_image
from gelform.background.untouched import (
    MIN_UNTOUCHED,
    remove_bias,
    untouched_from_color_change,
    untouched_pixels,
)
from made.touched_images import scene, touched

SHAPE = (40, 60)


def test_untouched_ignores_an_exposure_step():
    rest = scene()
    change = color_change_from_image(np.clip(touched(rest) * 1.05, 0, 255), rest)
    untouched = untouched_from_color_change(change, 0.05)
    assert untouched[:15].all()
    assert not untouched[22:38, 32:48].any()


def change_where(share):
    """A colour change of 0.2 on a share of the frame's rows, noise of 0.01 elsewhere."""
    change = np.random.default_rng(0).normal(0, 0.01, (*SHAPE, 3)).astype(np.float32)
    change[: round(share * SHAPE[0])] += np.array([0.2, -0.2, 0.1], dtype=np.float32)
    return change


def test_hidden_pixels_are_never_untouched():
    hidden = np.zeros(SHAPE, dtype=bool)
    hidden[30:, 40:] = True
    untouched, findings = untouched_pixels(change_where(0.25), 0.1, hidden)
    assert findings == ()
    np.testing.assert_array_equal(untouched[10:], ~hidden[10:])
    assert not untouched[:10].any()


def test_where_everything_is_touched_the_least_changed_stand_in():
    ramp = np.linspace(-0.5, 0.5, SHAPE[1], dtype=np.float32)[None, :, None]
    change = np.broadcast_to(ramp, (*SHAPE, 3)) + np.float32(0.6)
    untouched, (finding,) = untouched_pixels(change, 1e-6, np.zeros(SHAPE, dtype=bool))
    assert finding.name == "few_untouched"
    assert finding.figure < MIN_UNTOUCHED
    assert untouched.mean() == pytest.approx(MIN_UNTOUCHED, abs=1 / SHAPE[1])
    assert untouched[:, 0].all()  # 0.1 is the least change


@pytest.mark.parametrize("shape", [(40, 60), (480, 640)])
def test_the_bias_is_the_median_of_the_untouched_slopes(shape):
    gradients = np.random.default_rng(1).normal(0, 0.02, (*shape, 2)).astype(np.float32)
    gradients += np.array([0.05, -0.03], dtype=np.float32)
    untouched = np.ones(shape, dtype=bool)
    untouched[: shape[0] // 3] = False
    gradients[~untouched] += 2.0
    remove_bias(gradients, untouched)
    np.testing.assert_allclose(np.median(gradients[untouched], axis=0), 0, atol=2e-3)
    np.testing.assert_allclose(np.median(gradients[~untouched], axis=0), 2, atol=3e-3)


def test_a_bias_is_found_where_the_lattice_misses_the_untouched():
    gradients = np.full((480, 640, 2), 0.4, dtype=np.float32)
    untouched = np.zeros((480, 640), dtype=bool)
    untouched[1, 1:5] = True
    remove_bias(gradients, untouched)
    np.testing.assert_array_equal(gradients, 0)
