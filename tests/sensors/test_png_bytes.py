"""PNG files: whole, damaged behind a right checksum, and with things in them that are no picture."""

import struct
import zlib

import cv2
import numpy as np
import pytest

import gelform
from gelform.sensors.png_bytes import png_of_pixels

IMAGE = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
CONTENT = cv2.imencode(".png", IMAGE[..., ::-1])[1].tobytes()


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def with_pixels_changed(change):
    """The PNG with other compressed pixels under a checksum that agrees."""
    at = CONTENT.index(b"IDAT")
    (length,) = struct.unpack(">I", CONTENT[at - 4 : at])
    data = change(CONTENT[at + 4 : at + 4 + length])
    return CONTENT[: at - 4] + chunk(b"IDAT", data) + CONTENT[at + 8 + length :]


def test_a_whole_file_keeps_its_pixels():
    assert png_of_pixels(CONTENT) is not None
    decoded = cv2.imdecode(np.frombuffer(png_of_pixels(CONTENT), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(decoded[..., ::-1], IMAGE)


def test_a_profile_that_is_junk_neither_harms_nor_speaks(tmp_path, capfd):
    path = tmp_path / "image.png"
    path.write_bytes(CONTENT[:33] + chunk(b"iCCP", b"junk") + chunk(b"tEXt", b"\x00") + CONTENT[33:])
    np.testing.assert_array_equal(gelform.read_image(path), IMAGE)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "content",
    [
        CONTENT[:-13],
        CONTENT[:60],
        with_pixels_changed(lambda data: data[:40] + bytes([data[40] ^ 255]) + data[41:]),
        with_pixels_changed(lambda data: data[:-20]),
        with_pixels_changed(lambda data: b""),
    ],
    ids=["no end", "cut", "changed pixels", "fewer pixels", "no pixels"],
)
def test_a_damaged_file_is_refused_in_one_line(tmp_path, capfd, content):
    assert png_of_pixels(content) is None
    path = tmp_path / "image.png"
    path.write_bytes(content)
    with pytest.raises(
        gelform.DataError, match=r"image.png is truncated or damaged. Copy or record it again."
    ):
        gelform.read_image(path)
    assert capfd.readouterr() == ("", "")


def test_a_small_file_cannot_ask_for_all_memory(monkeypatch):
    monkeypatch.setattr("gelform.sensors.png_bytes.MAX_PIXEL_BYTES", 1000)
    assert png_of_pixels(CONTENT) is None
