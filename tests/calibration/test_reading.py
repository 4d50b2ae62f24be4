"""What a calibration reads of a press while it is made is what a Reconstructor reads of the image then."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.reading import SlopeReader
from gelform.reconstruct import Reconstructor


@pytest.fixture
def reader(calibration, prepared):
    """Makes a reader of the calibration's color model with a forward response."""
    untouched = calibration.untouched_change
    return lambda forward: SlopeReader(calibration.color_model, forward, prepared[0], untouched)


@pytest.mark.parametrize("step", [True, False])
def test_slopes_are_those_that_a_reconstructor_reads(calibration, presses, prepared, reader, step):
    """Of whole images, with and without the step; but for the bias, which it takes away from all slopes alike."""
    forward = calibration.forward if step else replace(calibration.forward, step_sigma=None)
    reconstruct = Reconstructor(replace(calibration, forward=forward), solver="dct", depth_sigma=False)
    for press, image in zip(prepared[:3], presses.presses):
        read = reader(forward).frame(press)
        apart = reconstruct.from_image(image.image).observed_gradients - read.gradients
        np.testing.assert_allclose(apart, np.broadcast_to(apart[0, 0], apart.shape), atol=1e-5)
        assert np.abs(apart[0, 0]).max() < 0.02
        assert read.variance.shape == read.residual.shape == press.size.shape


def test_without_a_step_nothing_is_stated(calibration, prepared, reader):
    """The deviation is all in the factors that held-out presses tell."""
    for forward in (None, replace(calibration.forward, step_sigma=None)):
        read = reader(forward).frame(prepared[1])
        assert (read.variance == 1).all()
        assert (read.residual == 0).all()
        plain = calibration.color_model.prepare(prepared[1].background, prepared[1].size.shape)
        np.testing.assert_array_equal(read.gradients, plain.gradients_from_color(prepared[1].color_change)[0])


def test_a_step_changes_slopes_and_states_them(calibration, prepared, reader):
    stepped, plain = (reader(forward).frame(prepared[1]) for forward in (calibration.forward, None))
    assert 1e-3 < np.abs(stepped.gradients - plain.gradients).mean() < 0.1
    at_rest, per_slope = calibration.forward.step_sigma
    prior = at_rest**2 + per_slope**2 * np.sum(np.square(plain.gradients), axis=-1)
    assert stepped.variance.min() > 0
    assert (stepped.variance <= prior * (1 + 1e-4)).all(), (
        "known better than before the step, wherever it is taken"
    )
    assert stepped.residual.min() >= 0


class Straight:
    """A color model that reads the slopes that lie in the color change."""

    def prepare(self, background, shape):
        assert background.shape == (*shape, 3)
        return self

    def gradients_from_color(self, color_change):
        return np.ascontiguousarray(color_change[..., :2]), None


@pytest.mark.parametrize("background", [None, np.full((90, 120, 3), 80.0, np.float32)])
def test_the_depth_is_that_of_the_slopes_that_the_model_reads(background):
    """A bump of 4 px, in pixels; untouched gel around it is at 0."""
    y, x = np.mgrid[:90, :120].astype(float)
    depth = 4 * np.exp(-((x - 70) ** 2 + (y - 40) ** 2) / 200)
    slopes = np.stack([40 - x + 30, 40 - y], axis=-1) * (depth / 100)[..., None]
    change = np.concatenate([slopes, slopes[..., :1]], axis=-1).astype(np.float32)
    press = PreparedPress("bump", change, np.linalg.norm(change, axis=-1), 40.0, background=background)
    found = SlopeReader(Straight(), None, press, 0.01).depth_px(press)
    np.testing.assert_allclose(found, depth, atol=0.3)
    assert found.min() == 0
