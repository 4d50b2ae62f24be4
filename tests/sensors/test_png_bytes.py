"""PNG files: complete, damaged behind a right checksum, and with metadata."""

import struct
import zlib

import cv2
import numpy as np
import pytest

import gelform
from gelform.sensors import png_bytes
from gelform.sensors.png_bytes import pixels_of_png
from kernel_agreement import assert_kernel_agrees

IMAGE = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
CONTENT = cv2.imencode(".png", IMAGE[..., ::-1])[1].tobytes()


@pytest.fixture(autouse=True, params=["zlib", "isal.isal_zlib"])
def decompressor(request, monkeypatch):
    """Every test with Python's own decompressor and with that of the extra png."""
    module = pytest.importorskip(request.param, reason="the extra png is not installed")
    monkeypatch.setattr(png_bytes, "inflate", module)


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def with_pixels_changed(change):
    """The PNG with other compressed pixels under a checksum that agrees."""
    at = CONTENT.index(b"IDAT")
    (length,) = struct.unpack(">I", CONTENT[at - 4 : at])
    data = change(CONTENT[at + 4 : at + 4 + length])
    return CONTENT[: at - 4] + chunk(b"IDAT", data) + CONTENT[at + 8 + length :]


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
    path = tmp_path / "image.png"
    path.write_bytes(content)
    with pytest.raises(
        gelform.DataError, match=r"image.png is truncated or damaged: .*\. Copy or record it again\."
    ):
        gelform.read_image(path)
    assert capfd.readouterr() == ("", "")


def test_a_small_file_cannot_ask_for_all_memory(monkeypatch):
    monkeypatch.setattr("gelform.sensors.png_bytes.MAX_PIXELS", 700)
    with pytest.raises(ValueError, match="24x32 px"):
        pixels_of_png(CONTENT)


def filtered(image, filters):
    """Rows by the filters of the specification, section 9.2, written out in whole numbers."""
    rows = []
    values = image.reshape(len(image), -1).astype(int)
    for k, (row, kind) in enumerate(zip(values, filters)):
        above = values[k - 1] if k else np.zeros_like(row)
        left, corner = (np.concatenate([np.zeros(3, int), one[:-3]]) for one in (row, above))
        estimate = left + above - corner
        sides = np.stack([left, above, corner])
        paeth = sides[np.argmin(np.abs(estimate - sides), axis=0), np.arange(len(row))]
        guess = (np.zeros_like(row), left, above, (left + above) // 2, paeth)[kind]
        rows.append(np.concatenate([[kind], (row - guess) % 256]))
    return np.array(rows, dtype=np.uint8)


def png_of(rows, header=(32, 24, 8, 2, 0, 0, 0), extra=b""):
    return png_of_stream(zlib.compress(bytes(rows)), header, extra)


def png_of_stream(stream, header=(32, 24, 8, 2, 0, 0, 0), extra=b""):
    chunks = [chunk(b"IHDR", struct.pack(">IIBBBBB", *header)), extra, chunk(b"IDAT", stream)]
    return b"".join([png_bytes.SIGNATURE, *chunks, chunk(b"IEND", b"")])


def test_every_filter_is_undone_in_one_chunk_or_several():
    for filters in [[kind] * 24 for kind in range(5)] + [[k % 5 for k in range(24)]]:
        content = png_of(filtered(IMAGE, filters).tobytes())
        np.testing.assert_array_equal(pixels_of_png(content), IMAGE)
        decoded = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(decoded[..., ::-1], IMAGE)
    smooth = np.repeat(np.arange(0, 240, 2, dtype=np.uint8)[:, None, None], 160, 1).repeat(3, 2)
    smooth[..., 1] += np.arange(160, dtype=np.uint8) % 17
    for image in (IMAGE, smooth, smooth[:, :1], smooth[:1]):
        content = cv2.imencode(".png", image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()
        np.testing.assert_array_equal(pixels_of_png(content), image)


def is_damaged(content):
    try:
        return pixels_of_png(content) is None
    except ValueError:
        return True


def test_a_damaged_stream_is_read_alike_whatever_decompresses_it():
    rng, outcomes = np.random.default_rng(0), set()
    rows = filtered(IMAGE // 16, [1] * 24).tobytes()
    for level in (0, 1, 9):
        whole = zlib.compress(rows, level)
        for _ in range(200):
            changed = bytearray(whole)
            changed[rng.integers(len(whole))] = rng.integers(256)
            try:
                expected = zlib.decompress(changed)
            except zlib.error:
                expected = None
            damaged = is_damaged(png_of_stream(bytes(changed)))
            assert damaged == (expected != rows)
            outcomes.add(damaged)
    assert True in outcomes


def test_other_kinds_are_left_to_the_decoder_and_wrong_rows_refused():
    rows = filtered(IMAGE, [0] * 24).tobytes()
    for kind in ((24, 16, 2, 0, 0, 0), (24, 8, 6, 0, 0, 0), (24, 8, 2, 0, 0, 1)):
        assert pixels_of_png(png_of(rows, (32, *kind))) is None
    assert pixels_of_png(png_of(rows, extra=chunk(b"tRNS", bytes(6)))) is None
    assert pixels_of_png(png_of(rows)) is not None
    unknown = bytearray(rows)
    unknown[5 * 97] = 5  # of a row's filter
    for content, said in (
        (png_of(rows, (0, 24, 8, 2, 0, 0, 0)), "24x0 px"),
        (png_of(rows[:-1]), "fewer or more"),
        (png_of(rows + b"x"), "fewer or more"),
        (png_of(unknown), "unknown filter"),
    ):
        with pytest.raises(ValueError, match=said):
            pixels_of_png(content)


def test_the_kernel_agrees_with_the_specification():
    rows, above = filtered(IMAGE, [k % 5 for k in range(24)]), np.zeros(96, dtype=np.uint8)
    unfiltered = IMAGE.reshape(24, -1)
    assert_kernel_agrees(png_bytes._png_rows, lambda *_: unfiltered, rows, above, np.zeros_like(unfiltered))
