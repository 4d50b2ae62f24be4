"""Messages of the page: written and read back; maps as bytes: steps, rounding, packing, both encodings."""

from __future__ import annotations

import zlib

import cv2
import numpy as np
import pytest

from gelform.errors import DataError
from gelform.exchange.exporters.quantised import ZERO_LEVEL
from gelform.live.web.wire import bits_plane, depth_plane, image_plane, level_plane, message, read_message

DEPTH = np.linspace(-0.1, 0.6, 35, dtype=np.float32).reshape(5, 7)


def test_planes_come_back_by_name():
    image = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)
    data = message({"serial": 4}, [image_plane(image, "raw"), depth_plane(DEPTH, "raw")])
    header, planes = read_message(data)
    assert header["serial"] == 4
    assert planes["image"] == image.tobytes()
    depth = header["planes"][1]
    levels = np.frombuffer(planes["depth"], np.uint16).reshape(depth["height"], depth["width"])
    np.testing.assert_allclose(
        (levels.astype(float) - depth["zero"]) * depth["step"], DEPTH, atol=0.51 * depth["step"]
    )


def test_planes_are_aligned_for_typed_arrays():
    odd = bits_plane("flags", np.ones((3, 5), np.uint8), "raw")
    data = message({"a": "ä"}, [odd, depth_plane(DEPTH, "raw")])
    header, _ = read_message(data)
    start = 8 + int.from_bytes(data[4:8], "little")
    assert all((start + plane["offset"]) % 8 == 0 for plane in header["planes"])


def test_torn_messages_and_other_bytes_are_refused():
    data = message({}, [depth_plane(DEPTH, "raw")])
    for cut in (0, 3, 7, 20, len(data) - 8):
        with pytest.raises((DataError, ValueError)):
            read_message(data[:cut])
    with pytest.raises(DataError, match="other bytes"):
        read_message(b"GET / HTTP/1.1\r\n")


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


def test_depth_is_exact_to_half_a_step_of_a_tenth_of_a_micrometer_that_grows_with_it(depth):
    plane = depth_plane(depth, "raw")
    assert plane.facts["step"] == 1e-4
    np.testing.assert_allclose(floats(plane), depth, atol=0.51e-4)
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
