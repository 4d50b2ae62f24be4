"""Maps as bytes: steps, rounding, packing, both encodings."""

import zlib

import cv2
import numpy as np
import pytest

from gelform.exporters.quantised import ZERO_LEVEL
from gelform.live.wire.planes import bits_plane, depth_plane, image_plane, level_plane


def floats(plane):
    """What the page makes of a plane."""
    facts, data = plane.facts, plane.data
    dtype = {"u8": np.uint8, "u16": np.uint16}[facts["kind"]]
    if facts["packed"]:
        steps = np.frombuffer(zlib.decompress(data), dtype).reshape(facts["height"], facts["width"])
        levels = np.cumsum(steps, axis=1, dtype=dtype)
    else:
        levels = np.frombuffer(data, dtype).reshape(facts["height"], facts["width"])
    return (levels.astype(float) - facts["zero"]) * facts["step"]


@pytest.fixture
def depth():
    y, x = np.mgrid[:40, :60].astype(np.float32)
    return (0.8 * np.exp(-((x - 30) ** 2 + (y - 15) ** 2) / 80) - 0.05).astype(np.float32)


def test_depth_is_exact_to_half_a_step_of_a_tenth_of_a_micrometre(depth):
    plane = depth_plane(depth, "raw")
    assert plane.facts["step"] == 1e-4
    np.testing.assert_allclose(floats(plane), depth, atol=0.51e-4)


def test_deep_depth_gets_larger_steps_instead_of_being_cut(depth):
    np.testing.assert_allclose(floats(depth_plane(10 * depth, "raw")), 10 * depth, atol=2e-4)


def test_zero_stays_zero_and_0_is_never_sent():
    plane = depth_plane(np.array([[0, -40]], np.float32), "raw")
    levels = np.frombuffer(plane.data, np.uint16)
    assert levels[0] == ZERO_LEVEL
    assert levels[1] >= 1


def test_small_depth_is_every_second_pixel_and_much_smaller(depth):
    plane = depth_plane(depth, "small")
    np.testing.assert_allclose(floats(plane), depth[::2, ::2], atol=0.51e-4)
    assert len(plane.data) < depth[::2, ::2].size * 2 / 1.5


def test_levels_are_cut_at_255_steps():
    values = np.array([[0.0, 0.5, 1.0, 7.0]], np.float32)
    np.testing.assert_allclose(
        floats(level_plane("confidence", values, "raw")), [[0, 0.502, 1, 1]], atol=1e-3
    )


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_bits_come_through_packing(dtype):
    bits = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (20, 30)).astype(dtype)
    np.testing.assert_array_equal(floats(bits_plane("causes", bits, "small")), bits[::2, ::2])
    np.testing.assert_array_equal(floats(bits_plane("causes", bits, "raw")), bits)


def test_the_image_is_rgb_raw_and_as_jpeg(depth):
    image = np.stack([np.full((40, 60), level, np.uint8) for level in (200, 100, 30)], axis=-1)
    assert image_plane(image, "raw").data == image.tobytes()
    jpeg = image_plane(image, "small")
    decoded = cv2.imdecode(np.frombuffer(jpeg.data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    np.testing.assert_allclose(decoded, image, atol=4)
