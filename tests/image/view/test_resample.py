"""Averages over boxes and one bilinear remap: areas are kept, and planes stay planes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelform.image.view.resample import (
    averaged,
    box_centers,
    maps_of_positions,
    pixel_maps,
    pixel_positions,
    remapped,
)


def plane(shape):
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.repeat((40 + 0.7 * x + 0.3 * y)[..., None], 3, axis=-1).astype(np.float32)


@given(st.integers(4, 60), st.integers(1, 60), st.booleans(), st.data())
def test_centers_lie_evenly_within_the_part(available, count, flipped, data):
    start = data.draw(st.floats(0, available - 2))
    length = data.draw(st.floats(1, available - start))
    centers, cut, box = box_centers(start, length, available, count, flipped)
    in_frame = (centers + 0.5) * box - 0.5 + cut.start
    edges = np.linspace(start, start + length, count + 1) - 0.5
    expected = (edges[1:] + edges[:-1]) / 2
    np.testing.assert_allclose(in_frame, expected[::-1] if flipped else expected, atol=1e-9)
    assert 0 <= cut.start < cut.stop <= available
    assert 1 <= box <= max(1, length / count + 0.5)


def test_averages_are_means_of_boxes_and_repeat_the_border():
    pixels = np.random.default_rng(0).uniform(0, 255, (7, 9, 3)).astype(np.float32)
    assert averaged(pixels, (1, 1)) is pixels
    small = averaged(pixels, (2, 3))
    assert small.shape == (4, 3, 3)
    np.testing.assert_allclose(small[:3], pixels[:6].reshape(3, 2, 3, 3, 3).mean(axis=(1, 3)), rtol=1e-5)
    np.testing.assert_allclose(small[3], pixels[6].reshape(3, 3, 3).mean(axis=1), rtol=1e-5)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_a_remap_reads_between_pixels_and_repeats_beyond(dtype):
    source = plane((12, 16)).astype(dtype)
    same = remapped(source, *maps_of_positions(pixel_positions((12, 16)), (12, 16)))
    np.testing.assert_array_equal(same, source)
    assert same.dtype == dtype
    beyond = remapped(source, *pixel_maps(np.array([-5.0, 99.0]), np.array([0.0])))
    np.testing.assert_array_equal(beyond[0], source[0, [0, -1]])


def test_maps_of_a_plane_are_exact_and_read_only():
    map_x, map_y = pixel_maps(np.array([1.5, 2.25, 9.0]), np.array([4.0, 6.5]))
    found = remapped(plane((12, 16)), map_x, map_y)[..., 0]
    np.testing.assert_allclose(found, 40 + 0.7 * map_x + 0.3 * map_y, rtol=1e-5)
    with pytest.raises(ValueError, match="read-only"):
        map_x[0, 0] = 1
