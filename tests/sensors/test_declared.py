"""What the header of a picture declares; more pixels than a sensor has are refused before they take memory."""

import struct
import tracemalloc
import zlib

import cv2
import numpy as np
import pytest

import gelform
from gelform.batch import run_batch
from gelform.errors import DataError
from gelform.foundations.pictures import picture_bytes
from gelform.image.frame import as_levels
from gelform.sensors.declared import check_declared, declared_shape
from gelform.sensors.jpeg import image_from_jpeg
from gelform.sensors.recordings.facts import image_from_encoded
from gelform.sensors.values import image_from_values

PICTURE = np.random.default_rng(0).integers(0, 256, (37, 91, 3), dtype=np.uint8)


def png_bomb(side):
    """A PNG of a few kB that declares side x side pixels and holds the first rows."""
    parts = [(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0))]
    parts += [(b"IDAT", zlib.compress(bytes(10**6), 9)), (b"IEND", b"")]
    chunks = (struct.pack(">I", len(d)) + n + d + struct.pack(">I", zlib.crc32(n + d)) for n, d in parts)
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tiff", ".webp", ".ppm"])
def test_every_kind_of_file_states_its_size(suffix):
    content = cv2.imencode(suffix, PICTURE)[1].tobytes()
    assert declared_shape(content) == (37, 91)
    with pytest.raises(ValueError, match="37x91 px"):
        check_declared(content, 37 * 91 - 1)
    for cut in range(60):
        check_declared(content[:cut])  # the decoder's to refuse


def test_lossless_and_extended_webp_and_other_byte_orders():
    lossless = cv2.imencode(".webp", PICTURE, [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()
    assert declared_shape(lossless) == (37, 91)
    extended = b"RIFF\x20\0\0\0WEBPVP8X\x0a\0\0\0" + bytes(4) + b"\x5a\0\0\x24\0\0"
    assert declared_shape(extended) == (37, 91)
    entries = struct.pack(">HHIHH", 256, 3, 1, 91, 0) + struct.pack(">HHII", 257, 4, 1, 37)
    assert declared_shape(b"MM\0*" + struct.pack(">IH", 8, 2) + entries) == (37, 91)


def test_bombs_are_refused_before_they_take_memory(tmp_path, calibration):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "bomb.png").write_bytes(png_bomb(30_000))
    tracemalloc.start()
    with pytest.raises(DataError, match=r"at most 200 megapixels, got one that states 30000x30000 px"):
        gelform.read_image(tmp_path / "in" / "bomb.png")
    with pytest.raises(DataError, match="30000x30000 px"):
        image_from_encoded(png_bomb(30_000), 1, "Frame 3")
    with pytest.raises(DataError, match="30000x30000 px"):
        image_from_values(np.frombuffer(png_bomb(30_000), np.uint8))
    (tmp_path / "in" / "bomb.png").write_bytes(png_bomb(12_000))  # beyond what this sensor has
    (tmp_path / "in" / "good.png").write_bytes(picture_bytes(as_levels(calibration.background)))
    summary = run_batch(tmp_path / "in", calibration, tmp_path / "out", table="csv")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (summary.frames, summary.errors) == (2, 1)
    assert "states 12000x12000 px" in (tmp_path / "out" / "frames.csv").read_text()
    assert peak < 200e6


def test_a_whole_frame_of_a_mini_is_still_refused_by_its_size(calibration):
    assert 25e6 <= calibration.most_pixels <= 200e6
    check_declared(
        cv2.imencode(".png", np.zeros((2464, 3280, 3), np.uint8))[1].tobytes(), calibration.most_pixels
    )


def test_a_jpeg_that_declares_four_gigapixels_is_torn():
    content = cv2.imencode(".jpg", PICTURE)[1].tobytes()
    at = content.index(b"\xff\xc0") + 5
    bomb = content[:at] + b"\xea\x60\xea\x60" + content[at + 4 :]
    with pytest.raises(DataError, match="60000x60000 px"):
        image_from_encoded(bomb, 1, "Frame 3")
    assert image_from_jpeg(bomb) is None
