"""JPEG files: whole, cut, and damaged in mid-file, where a decoder fills the picture up."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import gelform
from gelform.sensors import jpeg_bytes
from gelform.sensors.jpeg_bytes import jpeg_fault
from hostile.damage import damaged
from hostile.small_gel import Touch, image_of
from kernel_agreement import assert_kernel_agrees, usable_isas

SMOOTH = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, (96, 128, 3), dtype=np.uint8), (0, 0), 2)
GEL = cv2.resize(
    image_of(Touch()), (320, 256), interpolation=cv2.INTER_CUBIC
)  # smooth, with a camera's noise
OPTIONS = {
    "usual": [],
    "own codes": [cv2.IMWRITE_JPEG_OPTIMIZE, 1],
    "restarts": [cv2.IMWRITE_JPEG_RST_INTERVAL, 3],
    "progressive": [cv2.IMWRITE_JPEG_PROGRESSIVE, 1],
    "4:1:1": [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_411],
    "4:4:4": [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444],
}


def jpeg(image=SMOOTH, quality=90, options=()):
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality, *options])[1].tobytes()


def scan_of(content):
    """Where the codes of the first scan begin."""
    at = content.index(b"\xff\xda")
    return at + 2 + int.from_bytes(content[at + 2 : at + 4], "big")


def without_codes(content):
    """Without its tables of codes, as cameras send it."""
    at = content.index(b"\xff\xc4")
    return content[:at] + content[content.index(b"\xff\xda") :]


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
@pytest.mark.parametrize("shape", [(96, 128), (1, 1), (17, 33)])
@pytest.mark.parametrize("quality", [5, 75, 100])
def test_whole_files_have_no_fault(options, shape, quality):
    image = np.ascontiguousarray(SMOOTH[: shape[0], : shape[1]])
    assert jpeg_fault(jpeg(image, quality, options)) is None
    assert jpeg_fault(jpeg(image[..., 0], quality, options)) is None


def test_frames_of_cameras_have_no_fault():
    """The usual codes left out, the buffer filled up behind the end."""
    assert jpeg_fault(without_codes(jpeg()) + bytes(500)) is None


def test_every_cut_is_seen():
    content = jpeg(SMOOTH[:32, :32])
    for end in range(3, len(content) - 2):
        assert jpeg_fault(content[:end]) is not None
        assert end < scan_of(content) or jpeg_fault(content[:end] + b"\xff\xd9") is not None


@pytest.mark.parametrize("options", ["usual", "own codes", "restarts", "4:1:1", "4:4:4"])
@pytest.mark.parametrize(
    ("lost", "least"), [("bytes that are missing", 98), ("zeros", 98), ("bytes of another place", 70)]
)
def test_a_lost_piece_is_seen(options, lost, least):
    """64 bytes at 100 places of the scan of a sensor's image; other codes may make as many blocks by chance."""
    content = jpeg(GEL, options=OPTIONS[options])
    start = scan_of(content)
    seen = 0
    for at in np.linspace(start, len(content) - 70, 100).astype(int):
        other = start + (at - start + 1500) % (len(content) - start - 70)
        piece = {"zeros": bytes(64), "bytes that are missing": b""}.get(lost, content[other : other + 64])
        seen += jpeg_fault(content[:at] + piece + content[at + 64 :]) is not None
    assert seen >= least


def test_half_of_single_wrong_bits_are_seen():
    """The others change a number into one of as many bits: docs/guarantees.md says so."""
    content = jpeg(GEL)
    rng = np.random.default_rng(1)
    places = rng.uniform(scan_of(content) / len(content), 1, 400)
    seen = [
        jpeg_fault(damaged(content, [("flip", place, int(rng.integers(8)))])) is not None for place in places
    ]
    assert 0.4 < np.mean(seen) < 0.9


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: c[: scan_of(c) + 900] + b"\xff\xd9", r"ends after \d+ % of the picture"),
        (lambda c: c[:-2] + bytes(40) + c[-2:], "is damaged before 100 % of the picture"),
        (
            lambda c: c.replace(b"\xff\xc0\x00\x11\x08\x00\x60", b"\xff\xc0\x00\x11\x08\x00\x00"),
            "damaged header",
        ),
        (lambda c: c[:-2], "ends before its end marker"),
        (lambda c: c[: c.index(b"\xff\xda")] + b"\xff\xd9", "lacks a part of the picture"),
    ],
    ids=["cut", "more than the picture", "no height", "no end", "no scan"],
)
def test_a_damaged_file_is_refused_in_one_line(tmp_path, capfd, change, said):
    path = tmp_path / "image.jpg"
    path.write_bytes(change(jpeg()))
    with pytest.raises(gelform.DataError, match=f"image.jpg is truncated or damaged: it .*{said}.*again"):
        gelform.read_image(path)
    assert capfd.readouterr() == ("", "")


def numbers_of_scan(scan, counts, symbols, blocks, steps, place, mcus, interval):
    """The same in Python, a bit at a time: how far a scan without restarts can be read."""
    codes = []
    for k in range(8):
        code, place_of, table = 0, 0, {}
        for length in range(1, 17):
            for _ in range(counts[k, length - 1]):
                table[length, code] = int(symbols[k, place_of])
                code, place_of = code + 1, place_of + 1
            code <<= 1
        codes.append(table)
    content = bytes(scan)
    end = next(i for i in range(len(content)) if content[i] == 255 and content[i + 1] != 0)
    bits = "".join(f"{byte:08b}" for byte in content[:end].replace(b"\xff\x00", b"\xff"))
    at = 0

    def symbol(table):
        nonlocal at
        for length in range(1, 17):
            if (length, int(bits[at : at + length], 2)) in table:
                at += length
                return table[length, int(bits[at - length : at], 2)]
        raise AssertionError("no such code")

    for _ in range(mcus):
        for _, first, others in blocks:
            size = symbol(codes[first])
            at += size
            k = 1
            while k < 64:
                one = symbol(codes[4 + others])
                if one == 0:
                    break
                at += one & 15
                k += (one >> 4) + 1
            assert k <= 64 or one == 0
    assert len(bits) - at < 8
    return np.array([mcus, end], np.int64)


def test_the_kernel_reads_what_a_decoder_reads(monkeypatch):
    calls = []
    kernel = jpeg_bytes._jpeg_scan
    monkeypatch.setattr(
        jpeg_bytes, "_jpeg_scan", lambda *a: calls.append([*a[:5], a[5].copy(), *a[6:]]) or kernel(*a)
    )
    assert jpeg_fault(jpeg(SMOOTH[:40, :40])) is None
    monkeypatch.undo()
    assert_kernel_agrees(jpeg_bytes._jpeg_scan, numbers_of_scan, *calls[0])
    assert usable_isas()
