"""What no press labels: slopes steeper than those shown at a place, and the gel around contacts."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration import unlabelled
from gelform.calibration.unlabelled import PLACES, steepest_at_places, surround_sigma
from gelform.color_models import Samples

SHAPE = (60, 80)


def samples_of(x, y, slopes):
    gradients = np.stack([0.6 * slopes, 0.8 * slopes], axis=1)
    return Samples(np.zeros((len(x), 3)), x, y, gradients, np.ones(len(x)), SHAPE)


def test_each_place_has_the_slopes_that_were_shown_there():
    y, x = (axis.ravel() for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])
    slopes = np.where(x < 40, 0.4, 0.8) * np.where(y < 30, 1.0, 0.5)
    nowhere = (x >= 70) & (y >= 50)
    found = np.array(steepest_at_places(samples_of(x[~nowhere], y[~nowhere], slopes[~nowhere])))
    assert found.shape == PLACES
    np.testing.assert_allclose(found[:3, :4], 0.4)
    np.testing.assert_allclose(found[:3, 4:], 0.8)
    np.testing.assert_allclose(found[3:, :4], 0.2)
    assert found[5, 7] == pytest.approx(0.2)  # nothing pressed there: as little as anywhere


def test_untouched_pixels_show_no_slope():
    y, x = (axis.ravel() for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])
    slopes = np.where((x + y) % 2, 0.5, 0.0)
    np.testing.assert_allclose(steepest_at_places(samples_of(x, y, slopes)), 0.5)


def test_light_that_changes_with_the_depth_raises_what_surroundings_may_be_off(prepared, found):
    some = [i for i, contact in enumerate(found) if contact.radius_px > 8][:10]
    presses, contacts = [prepared[i] for i in some], [found[i] for i in some]
    depth = [_cap(press, contact) for press, contact in zip(presses, contacts)]
    before = surround_sigma(presses, contacts, 0.8)
    changed = [
        replace(press, color_change=press.color_change * (1 + 0.05 * z[..., None]))
        for press, z in zip(presses, depth)
    ]
    after = surround_sigma(changed, contacts, 0.8)
    assert 0 < before < after < unlabelled.MOST


def _cap(press, contact):
    """Depth, px, of a ball and of gel that falls off around it."""
    rows, cols = np.ogrid[: press.size.shape[0], : press.size.shape[1]]
    distance = np.hypot(cols - contact.x_px, rows - contact.y_px)
    radius = press.ball_radius_px
    rim = np.sqrt(radius**2 - contact.radius_px**2)
    cap = np.sqrt(np.maximum(radius**2 - distance**2, 0)) - rim
    return np.maximum(cap + 3, 3 * np.exp(-np.maximum(distance - contact.radius_px, 0) / 4)).astype(
        np.float32
    )
