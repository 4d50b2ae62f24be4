"""JPEG and PNG: complete, truncated, damaged behind a right checksum or where a decoder fills the picture; with metadata.

What a header declares: more pixels than a sensor has take no memory. Images from values of data sets and arrays of numpy.
"""

from __future__ import annotations

import pickle
import re
import struct
import tracemalloc
import zlib
from functools import partial
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pytest

import gelform
from gelform.batch import run_batch
from gelform.errors import DataError
from gelform.foundations.files import picture_bytes, read_npy
from gelform.image.view import as_levels
from gelform.sensors import pictures
from gelform.sensors.pictures import (
    IMAGE_SUFFIXES,
    MAX_STRICT_BYTES,
    check_declared,
    declared_shape,
    image_from_bytes,
    image_from_jpeg,
    image_from_values,
    npy_values,
    pixels_of_jpeg,
    pixels_of_png,
    reduction_of,
)
from gelform.sensors.playback import image_from_encoded
from hostile.damage import damaged
from kernel_agreement import assert_kernel_agrees
from made.small_gel import Touch, image_of

SMOOTH = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, (96, 128, 3), dtype=np.uint8), (0, 0), 2)
# Smooth, with a camera's noise.
GEL = cv2.resize(image_of(Touch()), (320, 256), interpolation=cv2.INTER_CUBIC)
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


IMAGE = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
CONTENT = cv2.imencode(".png", IMAGE[..., ::-1])[1].tobytes()


@pytest.fixture(params=["zlib", "isal.isal_zlib"])
def decompressor(request, monkeypatch):
    """Every test with Python's own decompressor and with that of the extra png."""
    module = pytest.importorskip(request.param, reason="the extra png is not installed")
    monkeypatch.setattr(pictures, "inflate", module)


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def with_pixels_changed(change):
    """The PNG with other compressed pixels under a checksum that agrees."""
    at = CONTENT.index(b"IDAT")
    (length,) = struct.unpack(">I", CONTENT[at - 4 : at])
    data = change(CONTENT[at + 4 : at + 4 + length])
    return CONTENT[: at - 4] + chunk(b"IDAT", data) + CONTENT[at + 8 + length :]


@pytest.mark.usefixtures("decompressor")
def test_a_profile_that_is_junk_neither_harms_nor_speaks(tmp_path, capfd):
    path = tmp_path / "image.png"
    path.write_bytes(CONTENT[:33] + chunk(b"iCCP", b"junk") + chunk(b"tEXt", b"\x00") + CONTENT[33:])
    np.testing.assert_array_equal(gelform.read_image(path), IMAGE)
    assert capfd.readouterr() == ("", "")


@pytest.mark.usefixtures("decompressor")
def test_a_damaged_file_is_refused_in_one_line(tmp_path, capfd):
    content, size = jpeg(), b"\xff\xc0\x00\x11\x08\x00\x60"
    for name, change, said in (
        ("a.jpg", content[: scan_of(content) + 900] + b"\xff\xd9", "premature end"),
        ("a.jpg", content[:-2] + bytes(40) + content[-2:], "extraneous bytes"),
        ("a.jpg", content.replace(size, size[:-1] + b"\x00"), ""),
        ("a.jpg", content[:-2], "Premature end"),
        ("a.jpg", content[: content.index(b"\xff\xda")] + b"\xff\xd9", ""),
        ("a.png", CONTENT[:-13], "checksum, or is missing"),  # no end
        ("a.png", CONTENT[:60], "checksum, or is missing"),
        ("a.png", with_pixels_changed(lambda data: data[:40] + bytes([data[40] ^ 255]) + data[41:]), ""),
        ("a.png", with_pixels_changed(lambda data: data[:-20]), ""),
        ("a.png", with_pixels_changed(lambda data: b""), "fewer or more"),
    ):
        (tmp_path / name).write_bytes(change)
        with pytest.raises(
            DataError, match=rf"{name} is truncated or damaged: .*{said}.*\. Copy or record it again\."
        ):
            gelform.read_image(tmp_path / name)
    assert capfd.readouterr() == ("", "")


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
    return b"".join([pictures.PNG, *chunks, chunk(b"IEND", b"")])


@pytest.mark.usefixtures("decompressor")
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


@pytest.mark.usefixtures("decompressor")
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


@pytest.mark.usefixtures("decompressor")
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
        (png_of(rows, (30_000, 24_000, 8, 2, 0, 0, 0)), "24000x30000 px"),
        (png_of(rows[:-1]), "fewer or more"),
        (png_of(rows + b"x"), "fewer or more"),
        (png_of(unknown), "unknown filter"),
    ):
        with pytest.raises(ValueError, match=said):
            pixels_of_png(content)


@pytest.mark.usefixtures("decompressor")
def test_the_kernel_agrees_with_the_specification():
    rows, above = filtered(IMAGE, [k % 5 for k in range(24)]), np.zeros(96, dtype=np.uint8)
    unfiltered = IMAGE.reshape(24, -1)
    assert_kernel_agrees(pictures._png_rows, lambda *_: unfiltered, rows, above, np.zeros_like(unfiltered))


PICTURE = np.random.default_rng(0).integers(0, 256, (37, 91, 3), dtype=np.uint8)


def png_bomb(side):
    """A PNG of a few kB that declares side x side pixels and holds the first rows."""
    return png_of_stream(zlib.compress(bytes(10**6), 9), (side, side, 8, 2, 0, 0, 0))


LOSSLESS = [cv2.IMWRITE_WEBP_QUALITY, 101]
ENTRIES = struct.pack(">HHIHH", 256, 3, 1, 91, 0) + struct.pack(">HHII", 257, 4, 1, 37)
SIZED = {
    **{suffix: cv2.imencode(suffix, PICTURE)[1].tobytes() for suffix in IMAGE_SUFFIXES},
    "lossless webp": cv2.imencode(".webp", PICTURE, LOSSLESS)[1].tobytes(),
    "extended webp": b"RIFF\x20\0\0\0WEBPVP8X\x0a\0\0\0" + bytes(4) + b"\x5a\0\0\x24\0\0",
    "tiff of the other order": b"MM\0*" + struct.pack(">IH", 8, 2) + ENTRIES,
}


@pytest.mark.parametrize("content", SIZED.values(), ids=SIZED)
def test_every_kind_of_file_states_its_size(content):
    assert declared_shape(content) == (37, 91)
    with pytest.raises(ValueError, match="37x91 px"):
        check_declared(content, 37 * 91 - 1)
    for cut in range(60):
        check_declared(content[:cut])  # the decoder's to refuse


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


def test_a_whole_frame_of_a_mini_passes_and_a_jpeg_that_declares_four_gigapixels_is_torn(calibration):
    assert 25e6 <= calibration.most_pixels <= 200e6
    whole = cv2.imencode(".png", np.zeros((2464, 3280, 3), np.uint8))[1].tobytes()
    check_declared(whole, calibration.most_pixels)
    content = cv2.imencode(".jpg", PICTURE)[1].tobytes()
    at = content.index(b"\xff\xc0") + 5
    bomb = content[:at] + b"\xea\x60\xea\x60" + content[at + 4 :]
    with pytest.raises(DataError, match="60000x60000 px"):
        image_from_encoded(bomb, 1, "Frame 3")
    assert image_from_jpeg(bomb) is None


def saved(kind, mode="RGB", frames=1, **options):
    """The bytes of a picture, or of several in one, as Pillow writes them."""
    pillow = pytest.importorskip("PIL.Image")
    images = [pillow.fromarray(np.roll(SMOOTH, 9 * k, axis=1)).convert(mode) for k in range(frames)]
    options |= {"save_all": True, "append_images": images[1:]} if frames > 1 else {}
    file = BytesIO()
    images[0].save(file, kind, **options)
    return file.getvalue()


def cut(content, percent):
    return content[: int(percent / 100 * len(content))]


REFUSED_PICTURES = {
    "gray PNG": (lambda: saved("PNG", "L"), "got a gray one"),
    "gray PNG with transparency": (lambda: saved("PNG", "LA"), "got a gray one"),
    "gray JPEG": (lambda: saved("JPEG", "L"), "got a gray one"),
    "gray TIFF with transparency": (lambda: saved("TIFF", "LA"), "got a gray one"),
    "gray BMP": (lambda: saved("BMP", "L"), "palette"),
    "PNG of a palette": (lambda: saved("PNG", "P"), "palette"),
    "BMP of a palette": (lambda: saved("BMP", "P"), "palette"),
    "TIFF of a palette": (lambda: saved("TIFF", "P"), "palette"),
    "CMYK JPEG": (lambda: saved("JPEG", "CMYK"), "CMYK"),
    "CMYK TIFF": (lambda: saved("TIFF", "CMYK"), "CMYK"),
    "Lab TIFF": (lambda: saved("TIFF", "LAB"), "CMYK"),
    "animated PNG": (lambda: saved("PNG", frames=3), "got several"),
    "animated WebP": (lambda: saved("WEBP", frames=3), "got several"),
    "GIF": (lambda: saved("GIF"), "no image that can be read"),
    "animated GIF": (lambda: saved("GIF", frames=3), "no image that can be read"),
    "AVIF": (lambda: saved("AVIF"), "no image that can be read"),
    "TIFF of pages": (lambda: saved("TIFF", frames=3), "several"),
    "16 bits": (lambda: cv2.imencode(".png", SMOOTH.astype(np.uint16) * 200)[1].tobytes(), "8-bit color"),
    "transparent": (
        lambda: cv2.imencode(".png", np.dstack([SMOOTH, SMOOTH[..., 0]]))[1].tobytes(), "transparency"
    ),
    **{
        f"JPEG cut to {share} %": (lambda share=share: cut(jpeg(GEL), share), "truncated or damaged")
        for share in (95, 98, 99.5)
    },
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED_PICTURES)
def test_what_is_no_color_frame_is_refused_as_a_file_and_within_one(tmp_path, kind):
    made, said = REFUSED_PICTURES[kind]
    content = made()
    suffix = ".tif" if content.startswith((b"II", b"MM")) else ".png"
    (tmp_path / f"picture{suffix}").write_bytes(content)
    padded = np.frombuffer(content + bytes(9), np.uint8)
    for read in (
        partial(gelform.read_image, tmp_path / f"picture{suffix}"),
        partial(image_from_values, padded),
    ):
        with pytest.raises(DataError, match=said):
            read()


@pytest.mark.parametrize("kind", ["JPEG", "TIFF", "PNG", "WEBP"])
@pytest.mark.parametrize("turn", [3, 6])
def test_pixels_are_those_stored_whatever_turn_a_tag_asks_for(tmp_path, kind, turn):
    exif = pytest.importorskip("PIL.Image").Exif()
    exif[274] = turn
    plain, tagged = (saved(kind, **options) for options in ({}, {"exif": exif}))
    assert len(tagged) > len(plain) or kind == "TIFF"
    (tmp_path / "a.tif").write_bytes(tagged)
    wanted = image_from_bytes(plain, "x")
    assert wanted.shape == SMOOTH.shape
    np.testing.assert_array_equal(gelform.read_image(tmp_path / "a.tif"), wanted)
    np.testing.assert_array_equal(image_from_values(np.frombuffer(tagged, np.uint8)), wanted)


IMAGE_VALUES = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)


def test_kinds_of_frames_and_what_is_refused():
    png = cv2.imencode(".png", IMAGE_VALUES[..., ::-1])[1].reshape(-1)
    for values in (
        IMAGE_VALUES,
        IMAGE_VALUES.astype(np.float32),
        np.concatenate([png, np.zeros(9, np.uint8)]),
        np.moveaxis(IMAGE_VALUES, 2, 0),
        *((IMAGE_VALUES / 255).astype(dtype) for dtype in (np.float16, np.float32, np.float64)),
        np.moveaxis(IMAGE_VALUES / 255, 2, 0),
    ):
        np.testing.assert_array_equal(image_from_values(values), IMAGE_VALUES)
    for values, said in (
        (IMAGE_VALUES / 300, r"Expected whole numbers from 0 to 255, or .* float64 \(6, 8, 3\)"),
        (IMAGE_VALUES.astype(np.float32) * 2, "Expected whole numbers from 0 to 255"),
        (np.full((6, 8, 3), np.nan), "Expected whole numbers"),
        (IMAGE_VALUES[..., :2], r"got \(6, 8, 2\)"),
        (IMAGE_VALUES / 255 - 0.5, "Expected whole numbers"),
        (np.zeros(0, np.uint8), "encoded picture is empty"),
        (np.arange(90, dtype=np.uint8), "encoded picture is no image that can be read"),
        (DataError("chunk 3 is damaged"), "chunk 3 is damaged"),
    ):
        with pytest.raises(DataError, match=said):
            image_from_values(values)


@pytest.mark.parametrize("kind", ["dict", "frames", "pickle"])
def test_pickled_arrays_are_named_with_the_line_that_converts_them(tmp_path, monkeypatch, kind):
    monkeypatch.chdir(tmp_path)
    path = Path("one.npy")
    if kind == "pickle":
        path.write_bytes(pickle.dumps(IMAGE_VALUES))
    else:
        objects = np.empty(() if kind == "dict" else 2, dtype=object)
        for place in np.ndindex(objects.shape):
            objects[place] = {"NAME": IMAGE_VALUES} if kind == "dict" else IMAGE_VALUES
        np.save(path, objects, allow_pickle=True)
    with pytest.raises(DataError, match=r"If you trust it, save .*numpy\.save") as raised:
        gelform.read_image(path)
    assert "pickle" in str(raised.value)
    assert "damaged" not in str(raised.value)
    with pytest.raises(DataError, match="If you trust it"):
        read_npy(path, "heights")
    if kind != "pickle":
        exec(re.search(r"numpy\.save\(.*\)", str(raised.value))[0], {"numpy": np})
        frames = np.load("frames.npy")
        np.testing.assert_array_equal(frames if kind == "dict" else frames[1], IMAGE_VALUES)


def test_arrays_of_numpy_are_images(tmp_path):
    path = tmp_path / "one.npy"
    for values in (IMAGE_VALUES, IMAGE_VALUES.astype(np.float64), IMAGE_VALUES / 255):
        np.save(path, values)
        np.testing.assert_array_equal(gelform.read_image(path), IMAGE_VALUES)
    for values, said in (
        (IMAGE_VALUES[..., 0], r"array \(N, H, W, 3\) or one .* at most 200 megapixels, got \(6, 8\)"),
        (np.moveaxis(IMAGE_VALUES, 2, 0), "Move the axis of the colors last"),
        (np.zeros((0, 6, 8, 3), np.uint8), r"got \(0, 6, 8, 3\)"),
        (IMAGE_VALUES.astype(np.int32) * 300, "one.npy: Expected whole numbers from 0 to 255"),
    ):
        np.save(path, values)
        with pytest.raises(DataError, match=said):
            gelform.read_image(path)
    path.write_bytes(path.read_bytes()[:90])
    with pytest.raises(DataError, match="no array file"):
        npy_values(path)
    with pytest.raises(DataError, match="No file"):
        npy_values(tmp_path / "none.npy")
    np.save(path, np.broadcast_to(np.uint8(7), (40, 50, 3)))
    with pytest.raises(DataError, match=r"at most 0.0019 megapixels, got \(40, 50, 3\)"):
        gelform.read_image(path, most_pixels=1900)
