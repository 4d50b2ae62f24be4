"""JPEG pictures: complete, truncated, and damaged in the middle, where a decoder fills the picture; size and pixels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import gelform
from gelform.sensors.jpeg import MAX_STRICT_BYTES, image_from_jpeg, jpeg_shape, pixels_of_jpeg, reduction_of
from hostile.damage import damaged
from made.small_gel import Touch, image_of

SMOOTH = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, (96, 128, 3), dtype=np.uint8), (0, 0), 2)
GEL = cv2.resize(
    image_of(Touch()), (320, 256), interpolation=cv2.INTER_CUBIC
)  # smooth, with a camera's noise
SAMPLING = cv2.IMWRITE_JPEG_SAMPLING_FACTOR
OPTIONS = {
    "usual": [],
    "own codes": [cv2.IMWRITE_JPEG_OPTIMIZE, 1],
    "restarts": [cv2.IMWRITE_JPEG_RST_INTERVAL, 3],
    "4:1:1": [SAMPLING, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_411],
    "4:4:4": [SAMPLING, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444],
    "progressive": [cv2.IMWRITE_JPEG_PROGRESSIVE, 1],
}


def jpeg(image=SMOOTH, quality=90, options=()):
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality, *options])[1].tobytes()


def scan_of(content):
    """Where the codes of the first scan begin."""
    at = content.index(b"\xff\xda")
    return at + 2 + int.from_bytes(content[at + 2 : at + 4], "big")


def fault(content):
    """What the decoder says of it; None where it is whole."""
    try:
        pixels_of_jpeg(content)
    except ValueError as problem:
        return str(problem)
    return None


def test_whole_files_have_the_pixels_that_opencv_reads():
    for options in OPTIONS.values():
        for height, width in ((96, 128), (1, 1), (17, 33)):
            for quality in (5, 75, 100):
                image = np.ascontiguousarray(SMOOTH[:height, :width])
                for picture in (image, image[..., 0]):
                    content = jpeg(picture, quality, options)
                    decoded = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
                    np.testing.assert_array_equal(pixels_of_jpeg(content), decoded[..., ::-1])


def test_every_cut_is_seen_and_frames_of_cameras_have_no_fault():
    """The usual codes left out, the buffer filled up behind the end."""
    content = jpeg(SMOOTH[:32, :32])
    for end in range(3, len(content) - 2):
        assert fault(content[:end]) is not None
        assert end < scan_of(content) or fault(content[:end] + b"\xff\xd9") is not None
    content = jpeg()
    usual_codes = content[content.index(b"\xff\xc4") : content.index(b"\xff\xda")]
    assert fault(content.replace(usual_codes, b"") + bytes(500)) is None


def test_a_lost_piece_is_seen():
    """64 bytes at 100 places of the scan of a sensor's image; other codes may make as many blocks by chance."""
    for options in OPTIONS.values():
        content = jpeg(GEL, options=options)
        start = scan_of(content)
        seen = {"missing": 0, "zeros": 0, "of another place": 0}
        for at in np.linspace(start, len(content) - 70, 100).astype(int):
            other = start + (at - start + 1500) % (len(content) - start - 70)
            pieces = {"zeros": bytes(64), "missing": b"", "of another place": content[other : other + 64]}
            for lost, piece in pieces.items():
                seen[lost] += fault(content[:at] + piece + content[at + 64 :]) is not None
        assert min(seen["missing"], seen["zeros"]) >= 97
        assert seen["of another place"] >= 70


def test_many_single_wrong_bits_are_seen():
    """The others change a number into one of as many bits: docs/guarantees.md says so."""
    content = jpeg(GEL)
    rng = np.random.default_rng(1)
    places = rng.uniform(scan_of(content) / len(content), 1, 400)
    seen = [fault(damaged(content, [("flip", place, int(rng.integers(8)))])) is not None for place in places]
    assert 0.4 < np.mean(seen) < 0.9


def test_a_damaged_file_is_refused_in_one_line(tmp_path, capfd):
    content, path = jpeg(), tmp_path / "image.jpg"
    size = b"\xff\xc0\x00\x11\x08\x00\x60"
    for change, said in (
        (content[: scan_of(content) + 900] + b"\xff\xd9", "premature end"),
        (content[:-2] + bytes(40) + content[-2:], "extraneous bytes"),
        (content.replace(size, size[:-1] + b"\x00"), ""),
        (content[:-2], "Premature end"),
        (content[: content.index(b"\xff\xda")] + b"\xff\xd9", ""),
    ):
        path.write_bytes(change)
        with pytest.raises(gelform.DataError, match=f"image.jpg is truncated or damaged: .*{said}.*again"):
            gelform.read_image(path)
    assert capfd.readouterr() == ("", "")


def test_the_size_stands_in_the_header():
    content = jpeg(SMOOTH[:48, :80])
    assert jpeg_shape(content) == (48, 80)
    assert jpeg_shape(b"\xff\xd8\xff\xfe\x00\x06abcd" + content[2:]) == (48, 80)
    assert jpeg_shape(b"\xff\xd8 no picture at all") is None
    assert jpeg_shape(b"") is None


def test_a_torn_picture_is_none():
    noise = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    small, large = jpeg(noise[:96, :128]), jpeg(noise)
    assert len(large) > MAX_STRICT_BYTES
    for content in (small, large):
        assert image_from_jpeg(content) is not None
        assert image_from_jpeg(content + bytes(100)) is not None, "as cameras pad"
        for torn in (content[:-2], content[: len(content) // 2], content[5:], b""):
            assert image_from_jpeg(torn) is None
    assert image_from_jpeg(small[:4000] + small[4600:]) is None
    assert image_from_jpeg(large[:-2] + b"x" + large[-2:]) is not None, "as large cameras do"


def test_large_frames_are_reduced_to_what_is_needed():
    for reduction, shapes in {
        1: [(240, 320), (720, 1280), (1920, 640)],
        2: [(960, 1280), (1080, 1920)],
        4: [(2448, 3264), (2160, 3840)],
        8: [(3840, 5120)],
    }.items():
        assert [reduction_of(shape) for shape in shapes] == [reduction] * len(shapes)


def test_a_reduced_picture_is_the_mean_of_its_blocks():
    y, x = np.mgrid[:96, :128]
    image = np.stack([x, y, x + y], axis=-1).astype(np.uint8)
    small = image_from_jpeg(jpeg(image[..., ::-1], 98), 4).astype(float)
    mean = image.reshape(24, 4, 32, 4, 3).mean(axis=(1, 3))
    assert small.shape == (24, 32, 3)
    assert np.abs(small - mean)[2:-2, 2:-2].mean() < 2
    for height, width in ((1922, 1283), (2464, 3280)):
        content = jpeg(cv2.resize(SMOOTH, (width, height)))
        for reduction in (2, 4, 8):
            found = image_from_jpeg(content, reduction)
            assert found.shape == (-(-height // reduction), -(-width // reduction), 3)
