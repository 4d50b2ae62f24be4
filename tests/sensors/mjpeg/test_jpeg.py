"""One JPEG picture: whole or torn, its size, its pixels at reduced size."""

import cv2
import numpy as np
import pytest

from gelform.sensors.mjpeg.jpeg import MAX_READ_BYTES, image_from_jpeg, is_whole, jpeg_shape, reduction_of
from made.mjpeg_server import jpeg


def large():
    noise = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    content = cv2.imencode(".jpg", noise)[1].tobytes()
    assert len(content) > MAX_READ_BYTES
    return content


def test_pixels_are_rgb():
    image = image_from_jpeg(jpeg(color=(200, 30, 10)))
    np.testing.assert_allclose(image[10, 10], (200, 30, 10), atol=3)


def test_the_size_stands_in_the_header():
    assert jpeg_shape(jpeg((48, 80))) == (48, 80)
    assert jpeg_shape(b"\xff\xd8\xff\xfe\x00\x06abcd" + jpeg((48, 80))[2:]) == (48, 80)
    assert jpeg_shape(b"\xff\xd8 no picture at all") is None
    assert jpeg_shape(b"") is None


@pytest.mark.parametrize("content", [jpeg(), large()], ids=["small", "large"])
def test_a_torn_picture_is_none(content):
    assert is_whole(content)
    assert is_whole(content + bytes(100))  # as cameras pad
    for torn in (content[:-2], content[: len(content) // 2], content[5:], b""):
        assert image_from_jpeg(torn) is None


def test_a_small_picture_with_a_hole_is_torn():
    rng = np.random.default_rng(1)
    content = cv2.imencode(".jpg", rng.integers(0, 256, (96, 128, 3), dtype=np.uint8))[1].tobytes()
    assert not is_whole(content[:4000] + content[4600:])


@pytest.mark.parametrize(
    ("shape", "reduction"),
    [
        ((240, 320), 1),
        ((720, 1280), 1),
        ((960, 1280), 2),
        ((1080, 1920), 2),
        ((2448, 3264), 4),
        ((2160, 3840), 4),
        ((3840, 5120), 8),
        ((1920, 640), 1),
    ],
)
def test_large_frames_are_reduced_to_what_is_needed(shape, reduction):
    assert reduction_of(shape) == reduction


def test_a_reduced_picture_is_the_mean_of_its_blocks():
    y, x = np.mgrid[:96, :128]
    image = np.stack([x, y, x + y], axis=-1).astype(np.uint8)
    content = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()
    small = image_from_jpeg(content, 4).astype(float)
    mean = image.reshape(24, 4, 32, 4, 3).mean(axis=(1, 3))
    assert small.shape == (24, 32, 3)
    assert np.abs(small - mean)[2:-2, 2:-2].mean() < 2
