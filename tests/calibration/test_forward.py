"""The forward response of presses, and the noise of images."""

import numpy as np
import pytest

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.samples import PreparedPress, contact_samples
from gelform.calibration.forward import (
    depth_in_contact,
    forward_from_presses,
    held_out_noise,
    image_noise,
)
from gelform.calibration.selection.folds import Fold
from gelform.simulate.twin import press_depth_of_rim

SHAPE = (80, 100)
BALL_PX, MM = 60.0, 0.05


def contact_at(x, y, radius):
    return ContactCircle(x_px=x, y_px=y, radius_px=radius, **dict.fromkeys(EXTRA, 1.0))


EXTRA = [name for name in ContactCircle.__dataclass_fields__ if name not in ("x_px", "y_px", "radius_px")]


def press_at(x, y, depth_change):
    """A press whose colour is twice its slope in red, minus its slope down in green, and its depth in blue."""
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    cosine = np.sqrt(np.maximum(BALL_PX**2 - (cols - x) ** 2 - (rows - y) ** 2, 1))
    p, q = -(cols - x) / cosine, -(rows - y) / cosine
    norm = np.sqrt(1 + p**2 + q**2)
    top = press_depth_of_rim(BALL_PX * MM, 25 * MM)
    depth = top + (cosine - BALL_PX) * MM
    change = np.stack([2 * p / norm, -q / norm, depth_change * depth], axis=-1).astype(np.float32)
    return PreparedPress("press", change, np.abs(change).sum(-1), BALL_PX)


def test_depth_and_slope_are_told_apart():
    places = [(30, 30), (60, 45), (50, 30), (35, 50)]
    presses = [press_at(x, y, 0.5) for x, y in places]
    contacts = [contact_at(x, y, 25.0) for x, y in places]
    response = forward_from_presses(presses, contacts, 0.8, MM, "GelSight Mini")
    at_top = response.color_from_gradients(
        np.zeros((1, 2)), np.array([50]), np.array([40]), depth_mm=np.array([0.4])
    )
    np.testing.assert_allclose(at_top, [[0, 0, 0.2]], atol=0.03)
    slope = np.array([[0.3, 0.2]])
    at_slope = response.color_from_gradients(slope, np.array([50]), np.array([40]), depth_mm=np.zeros(1))
    norm = np.sqrt(1 + 0.13)
    np.testing.assert_allclose(at_slope, [[0.6 / norm, -0.2 / norm, 0]], atol=0.05)


@pytest.mark.parametrize(
    ("sensor_name", "top_mm"),
    [
        ("GelSight Mini, unit A", press_depth_of_rim(3.0, 1.25)),  # its gel is known
        ("DIGIT", 3 - np.sqrt(9 - 1.25**2)),  # nothing but the ball is known
        ("my sensor", 3 - np.sqrt(9 - 1.25**2)),
    ],
)
def test_depth_in_the_contact_is_the_balls(sensor_name, top_mm):
    contact = contact_at(50.0, 40.0, 25.0)
    samples = contact_samples([press_at(50, 40, 0)], [contact], 0.8)
    depth = depth_in_contact(samples, contact, BALL_PX, MM, sensor_name)
    r = np.hypot(samples.x_px - 50, samples.y_px - 40) * MM
    np.testing.assert_allclose(depth.max() - depth, 3 - np.sqrt(9 - r**2), atol=1e-9)
    assert depth.max() == pytest.approx(top_mm)


def test_the_noise_of_images_is_found_under_what_is_smooth():
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:120, :160] / 20
    background = (100 + 10 * np.sin(x) + 5 * np.cos(y))[..., None] * np.ones(3)
    images = [
        background + (20 * np.sin(x + k))[..., None] + rng.normal(size=(120, 160, 3)) * [1, 2, 3]
        for k in range(15)
    ]
    np.testing.assert_allclose(image_noise(images, background.astype(np.float32)), [1, 2, 3], rtol=0.03)


class TrueSlopes:
    """Reads the slopes that lie in the color change, as `press_at` puts them there."""

    def gradients_at(self, change, x_px, y_px):
        normal = np.asarray(change)[:, :2] * [0.5, -1.0]
        return normal / np.sqrt(1 - np.square(normal).sum(axis=1, keepdims=True))


@pytest.mark.parametrize("added", [0.0, 0.4])
def test_noise_is_that_of_presses_held_out(added):
    """One press out of four has a colour of its own: of those that train without it nothing is left unexplained."""
    places = [(30, 30), (60, 45), (50, 30), (35, 50)]
    presses = [press_at(x, y, 0.0) for x, y in places]
    presses[3].color_change[:] += np.float32(added) * np.array([0, 0, 1], np.float32)
    found = [contact_at(x, y, 25.0) for x, y in places]
    folds = [Fold((3,), (0, 1, 2), tuple(found[:3]))]
    forwards = [forward_from_presses(presses[:3], found[:3], 0.8, MM, "my sensor")]
    noise = held_out_noise(forwards, [TrueSlopes()], folds, presses, found)
    assert max(forwards[0].noise) < 0.01
    assert noise == pytest.approx(added / 3**0.5 / 1.61, abs=0.05)  # the polynomial itself misses by 0.04
