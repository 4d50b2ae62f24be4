"""Samples carry what color models learn from."""

import numpy as np

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.samples import PreparedPress, contact_samples, with_rest_samples


def test_samples_carry_the_balls_slopes_and_the_untouched_image():
    background = np.full((60, 80, 3), 90, np.float32)
    change = np.zeros((60, 80, 3), np.float32)
    press = PreparedPress("one", change, change[..., 0], 40.0, background=background)
    contact = ContactCircle(40.0, 30.0, 15.0, 1.0, 9.0)
    samples = contact_samples([press], [contact], 0.8)
    assert samples.background is background
    u, v = samples.x_px - 40, samples.y_px - 30
    assert np.hypot(u, v).max() < 12
    np.testing.assert_allclose(
        samples.gradients, -np.stack([u, v], 1) / np.sqrt(1600 - u**2 - v**2)[:, None], rtol=1e-6
    )
    rested = with_rest_samples(samples, [press], [contact])
    assert rested.background is background
    assert len(rested.x_px) > len(samples.x_px)
    assert not rested.gradients[len(samples.x_px) :].any()
