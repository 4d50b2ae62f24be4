"""The gel's relaxation length, from balls pressed into a membrane on an elastic bed."""

import numpy as np
import pytest

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.relaxation import relaxation_from_presses, slopes_around
from gelform.simulate import LAYOUTS, Ball
from gelform.simulate.gel import contact_radius_of_ball, surface_from_ball

PITCH = 0.0634
REST = np.zeros((240, 320, 3), np.float32)


class SlopesAsColors:
    """A color model whose color changes are the slopes themselves."""

    def prepare(self, background, shape):
        return self

    def gradients_from_color(self, change):
        return change[..., :2], None


def presses(length, noise=0.02, tilt=0.0, centers=((0, 0), (-2, 1), (3, -2))):
    x_mm, y_mm = LAYOUTS["three-edges"].grid_mm()
    rng, made, circles = np.random.default_rng(0), [], []
    for center, radius, depth in zip(centers, (2.5, 4.0, 2.5), (0.3, 0.4, 0.5)):
        surface = surface_from_ball(
            Ball(radius), x_mm, y_mm, center_mm=center, depth_mm=depth, relaxation_mm=length
        )
        change = rng.normal(tilt, noise, REST.shape).astype(np.float32)
        change[..., :2] += surface.gradients
        made.append(PreparedPress("a", change, np.zeros(REST.shape[:2], np.float32), radius / PITCH))
        contact_px = contact_radius_of_ball(radius, depth, length) / PITCH
        middle = (center[0] / PITCH + 159.5, center[1] / PITCH + 119.5)
        circles.append(ContactCircle(*middle, contact_px, 0.9, 5.0))
    return made, circles


@pytest.mark.parametrize("length", [0.3, 0.5, 0.9])
@pytest.mark.parametrize("tilt", [0.0, 0.05])
def test_the_length_of_simulated_gels(length, tilt):
    made, circles = presses(length, tilt=tilt)
    assert relaxation_from_presses(SlopesAsColors(), made, circles, REST, PITCH) == pytest.approx(
        length, rel=0.06
    )


def test_nothing_is_said_of_noise_or_of_contacts_that_are_cut():
    rng = np.random.default_rng(0)
    made, circles = presses(0.5)
    for one in made:
        one.color_change[:] = rng.normal(0, 0.02, REST.shape)
    assert relaxation_from_presses(SlopesAsColors(), made, circles, REST, PITCH) is None
    made, circles = presses(0.5, centers=((-10, 0), (10, 1), (0, 7.5)))
    assert relaxation_from_presses(SlopesAsColors(), made, circles, REST, PITCH) is None


def test_rings_hold_the_outward_slope_and_leave_out_what_is_not_usable():
    y, x = np.mgrid[:240, :320].astype(np.float32)
    gradients = np.stack([0.1 * (x - 160), 0.1 * (y - 120)], axis=-1)
    usable = (x + y) % 9 > 0
    r_mm, slope, pixels = slopes_around(gradients, ContactCircle(160, 120, 20, 0.9, 5.0), usable, PITCH)
    np.testing.assert_allclose(slope, 0.1 * r_mm / PITCH, rtol=1e-4)
    assert r_mm[0] > 24 * PITCH
    assert pixels.sum() == pytest.approx(8 / 9 * np.pi * ((r_mm[-1] / PITCH) ** 2 - 25**2), rel=0.03)
