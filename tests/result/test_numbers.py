"""The numbers of a result are those of its maps, in mm or in pixels."""

from dataclasses import replace

import numpy as np
import pytest


@pytest.fixture
def pressed(result):
    """Depth that grows to the right, deepest at a pixel whose depth is not known."""
    depth = np.tile(np.arange(32, dtype=np.float32) / 100, (24, 1))
    known = np.ones(result.shape, dtype=bool)
    depth[0, 0], depth[5, 20], depth[7, 9] = 3.77, 0.9, -0.2
    known[0, 0] = False
    return replace(result, depth=depth, known=known)


def test_depth_is_that_of_known_pixels(pressed):
    numbers = pressed.numbers
    assert (numbers.peak, numbers.lowest) == (np.float32(0.9), np.float32(-0.2))
    assert (numbers.x_px, numbers.y_px) == (20, 5)
    assert numbers.peak == pressed.peak_mm
    assert "3.77" not in repr(pressed)
    unknown = replace(pressed, known=np.zeros_like(pressed.known))
    assert unknown.numbers is None
    assert np.isnan(unknown.peak_mm)


@pytest.mark.parametrize("mm_per_px", [0.0634, (0.05, 0.08), None])
def test_area_and_volume_are_of_all_contacts(pressed, mm_per_px):
    numbers = replace(pressed, mm_per_px=mm_per_px).numbers
    pixel = np.prod(np.broadcast_to(mm_per_px or 1, 2))
    assert (numbers.contacts, numbers.contact_px) == (2, 30)
    assert numbers.area == pytest.approx(30 * pixel)
    assert numbers.volume == pytest.approx(pressed.depth[pressed.contact].sum(dtype=float) * pixel)
    assert numbers.over_time == {"peak": numbers.peak, "area": numbers.area, "volume": numbers.volume}
