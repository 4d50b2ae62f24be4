"""The displayed data of one frame, encoded once for all clients as binary messages, and its numbers.

The page's binary messages: a header and maps as bytes: depth as uint16, levels as uint8, the image raw or as JPEG.

A message is magic bytes, the header's length, the header as JSON, then the planes, each aligned to 8 bytes. There are two
encodings. `raw` is for a browser on the same machine, where bytes are cheap and time is not. `small` is for a network:
the image as JPEG, maps at half the resolution, packed with deflate.
"""

from __future__ import annotations

import json
import struct
import tempfile
import threading
import zlib
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError, GelformError
from gelform.exchange.exporters.surface import MM_PER_LEVEL, ZERO_LEVEL, save_surface
from gelform.exchange.plots import picture
from gelform.foundations.pictures import picture_bytes
from gelform.image.frame import Frame
from gelform.result import Reconstruction, save_result
from gelform.result.maps import MAP_PLANES
from gelform.result.numbers import Numbers
from gelform.sensors.recordings.player import ReplayedFrame
from gelform.slopes.budget import Explanation
from gelform.slopes.sigma import CAUSES

ENCODINGS = ("raw", "small")
JPEG_QUALITY = 80  # of 100
LARGEST = 32767  # levels on either side of zero
MAGIC = b"GFL1"
ALIGNMENT = 8  # bytes, required by typed arrays in the browser


@dataclass(frozen=True)
class Plane:
    """A map's bytes.

    Attributes
    ----------
    facts : name, kind, height, width, packed; zero and step if its numbers are scaled
    data : the bytes
    """

    facts: dict[str, Any]
    data: bytes


def image_plane(image: NDArray[Any], encoding: str) -> Plane:
    """The image (H, W, 3) RGB, 0-255: `raw` bytes or a JPEG."""
    pixels = np.ascontiguousarray(image, dtype=np.uint8)
    if encoding == "raw":
        return _plane("image", "rgb", pixels)
    done, jpeg = cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise DataError(f"OpenCV cannot encode an image of {pixels.shape[0]}x{pixels.shape[1]} px as JPEG.")
    return Plane(_facts("image", "jpeg", pixels.shape), jpeg.tobytes())


def depth_plane(depth: NDArray[np.float32], encoding: str, name: str = "depth") -> Plane:
    """Depth (H, W) as uint16 in steps of 1e-4 mm around 32768, or in larger steps if the range requires it.

    0 is never sent, because files use it for unknown pixels.
    """
    reach = float(np.abs(depth).max(initial=0.0))
    step = max(MM_PER_LEVEL, reach / LARGEST)
    levels = np.rint(depth * np.float32(1 / step)).astype(np.int32) + ZERO_LEVEL
    return _numbers(name, levels.clip(1, 65535).astype(np.uint16), encoding, zero=ZERO_LEVEL, step=step)


def level_plane(name: str, values: NDArray[Any], encoding: str, *, step: float = 1 / 255) -> Plane:
    """Values from 0 up (H, W) as uint8 in the given steps; values above 255 steps are clipped."""
    levels = np.rint(np.clip(values * np.float32(1 / step), 0, 255)).astype(np.uint8)
    return _numbers(name, levels, encoding, zero=0, step=step)


def bits_plane(name: str, bits: NDArray[Any], encoding: str) -> Plane:
    """Bit sets (H, W), uint8 or uint16; at lower resolution every second pixel."""
    return _numbers(name, bits, encoding, zero=0, step=1)


def _numbers(name: str, levels: NDArray[Any], encoding: str, *, zero: int, step: float) -> Plane:
    meaning = {"zero": zero, "step": step}
    if encoding == "raw":
        return _plane(name, f"u{8 * levels.itemsize}", levels, meaning)
    half = levels[::2, ::2]
    # Differences along rows are small on a smooth surface; they compress three times better.
    steps = np.diff(half, axis=1, prepend=half.dtype.type(0))
    data = zlib.compress(np.ascontiguousarray(steps).tobytes(), 1)
    return Plane(_facts(name, f"u{8 * levels.itemsize}", half.shape, packed=True) | meaning, data)


def _plane(name: str, kind: str, pixels: NDArray[Any], meaning: dict[str, Any] | None = None) -> Plane:
    return Plane(_facts(name, kind, pixels.shape) | (meaning or {}), np.ascontiguousarray(pixels).tobytes())


def _facts(name: str, kind: str, shape: tuple[int, ...], *, packed: bool = False) -> dict[str, Any]:
    return {"name": name, "kind": kind, "height": shape[0], "width": shape[1], "packed": packed}


def message(header: Mapping[str, Any], planes: Sequence[Plane]) -> bytes:
    """Bytes of a message.

    The header gains `planes`: for each its name, kind ("u8", "u16", "rgb", "jpeg"), height and width, whether it is packed
    ("deflate"), and `offset` and `length` in bytes from the end of the header. Number planes also have `zero` and
    `step`, with value = (number - zero) * step.
    """
    listed, at = [], 0
    for plane in planes:
        listed.append({**plane.facts, "offset": at, "length": len(plane.data)})
        at += _padded(len(plane.data))
    text = json.dumps({**header, "planes": listed}, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-(len(MAGIC) + 4 + len(text)) % ALIGNMENT)
    parts = [MAGIC, struct.pack("<I", len(text)), text]
    for plane in planes:
        parts += [plane.data, b"\0" * (_padded(len(plane.data)) - len(plane.data))]
    return b"".join(parts)


def read_message(data: bytes) -> tuple[dict[str, Any], dict[str, bytes]]:
    """The header and the bytes of each plane by name, for a client in Python.

    Raises
    ------
    DataError
        This is no such message, or it is truncated.
    """
    if data[:4] != MAGIC or len(data) < 8:
        raise DataError("Expected a message of gelform live, got other bytes.")
    start = 8 + struct.unpack("<I", data[4:8])[0]
    if start > len(data):
        raise DataError(f"Expected a header of {start - 8} bytes, got {len(data) - 8}.")
    header = json.loads(data[8:start])
    planes = {}
    for plane in header["planes"]:
        first = start + plane["offset"]
        planes[plane["name"]] = data[first : first + plane["length"]]
        if len(planes[plane["name"]]) != plane["length"]:
            raise DataError(f"Expected {plane['length']} bytes of {plane['name']}: the message is truncated.")
    return header, planes


def _padded(length: int) -> int:
    return length + (-length % ALIGNMENT)


PLANES = ("image", "flags", "unknown", "causes", *MAP_PLANES)
CONTACT, KNOWN = 1, 2  # bits of the plane `flags`
MOST_CONTACTS, MOST_OUTLINES = 8, 32  # sent per frame at most
SNAPSHOT_FILES = ("frame.png", "result.npz", "surface.ply", "picture.png")
KEPT_SNAPSHOTS = 16  # snapshots that are kept
OUTLINE_PX = 0.6  # px, largest distance of an outline from the edge of the pixels


def outlines_of(result: Reconstruction) -> list[list[int]]:
    """An outline of each contact, also of one inside a ring: x, y, x, y ... in px of the image; only the largest of many."""
    found, inside = cv2.findContours(result.contact.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    outer = [
        one for one, (*_, parent) in zip(found, inside[0] if found else ()) if parent < 0
    ]  # no edges of holes
    largest = sorted(outer, key=len, reverse=True)[:MOST_OUTLINES]
    simple: list[Any] = [cv2.approxPolyDP(outline, OUTLINE_PX, True) for outline in largest]
    return [outline.ravel().tolist() for outline in simple]


@dataclass(eq=False)
class Shown:
    """One frame of a station with its result, if there is one.

    Attributes
    ----------
    serial : running number of the station's frames; larger is newer
    frame : from the camera
    image : (H, W, 3) uint8, after the view
    result : Reconstruction or None: no calibration, or this frame could not be reconstructed
    explain : computes the explanation of the image on request, because it takes longer than a frame
    problem : why there is no result; "" if there is one
    learn : learns from the result for the coming frames; None if there is nothing to learn
    motion : where the object moved since it touched, as `MovedSince` gives it; None if nobody asks
    """

    serial: int
    frame: Frame
    image: NDArray[np.uint8]
    result: Reconstruction | None = None
    explain: Callable[[], Explanation] | None = None
    problem: str = ""
    learn: Callable[[], None] | None = None
    motion: dict[str, Any] | None = None
    _made: dict[Any, Any] = field(default_factory=dict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def numbers(self) -> Numbers | None:
        """The numbers of the result; None without a result, or if nothing is known, and then no map is shown."""
        return None if self.result is None else self.result.numbers

    def planes(self, names: Sequence[str], encoding: str) -> list[Plane]:
        """The planes with those names that this frame has."""
        made = [self._once((name, encoding), lambda name=name: self._plane(name, encoding)) for name in names]
        return [plane for plane in made if plane is not None]

    def header(self) -> dict[str, Any]:
        """The data of the frame besides its pixels."""
        facts: dict[str, Any] = self._once("header", self._header)
        return facts

    def _once(self, key: Any, make: Any) -> Any:
        with self._lock:
            if key not in self._made:
                self._made[key] = make()
            return self._made[key]

    def _plane(self, name: str, encoding: str) -> Plane | None:
        result = self.result
        if name == "image":
            return image_plane(self.image, encoding)
        if result is None or self.numbers is None:
            return None
        if name == "depth":
            return depth_plane(result.depth, encoding)
        if (row := MAP_PLANES.get(name)) is not None:
            values = getattr(result, row.name)
            return None if values is None else level_plane(name, values, encoding, step=row.plane_step)
        if name == "causes" and self.explain is not None:
            return bits_plane("causes", _cause_bits(self.explain()), encoding)
        if name == "unknown":
            return (
                None
                if result.known.all()
                else bits_plane("unknown", (~result.known).view(np.uint8), encoding)
            )
        if name == "flags":
            bits = result.contact.view(np.uint8) * CONTACT + result.known.view(np.uint8) * KNOWN
            return bits_plane("flags", bits, encoding)
        return None

    def _header(self) -> dict[str, Any]:
        height, width = self.image.shape[:2]
        facts: dict[str, Any] = {
            "serial": self.serial,
            "index": self.frame.index,
            "time_s": self.frame.time_s,
            "height": height,
            "width": width,
            "problem": self.problem,
        }
        if isinstance(self.frame, ReplayedFrame):
            facts["replay"] = [self.frame.number, self.frame.recorded_s]
        if self.result is None:
            return facts
        findings = [[f.name, f.message, float(f.figure)] for f in self.result.health]
        if (numbers := self.numbers) is None:
            return facts | {"health": findings, "problem": " ".join(f.message for f in self.result.health)}
        pitch = self.result.mm_per_px
        return facts | {
            "unit": "px" if pitch is None else "mm",
            "mm_per_px": None if pitch is None else [float(p) for p in np.broadcast_to(pitch, 2)],
            **numbers.over_time,
            "peak_px": [numbers.x_px, numbers.y_px],
            "outlines": outlines_of(self.result),
            "contacts": [asdict(contact) for contact in self.result.contacts[:MOST_CONTACTS]],
            "markers": _marker_rows(self.result),
            "force": None if self.result.force_model is None else self.result.force.columns(),
            "motion": self.motion,
            "causes": list(CAUSES),
            "cause_colors": [cause.color for cause in CAUSES.values()],
            "solver": self.result.solver,
            "curl_rms": self.result.curl_rms,
            "health": findings,
        }


def _cause_bits(explanation: Explanation) -> NDArray[np.uint16]:
    """One bit per cause, at pixels where it alone makes a slope less certain than a clean one."""
    bits = np.zeros(explanation.confidence.shape, dtype=np.uint16)
    for number, one in enumerate(explanation.maps.values()):
        bits |= np.where(one > explanation.full_confidence_sigma, np.uint16(1 << number), np.uint16(0))
    return bits


def _marker_rows(result: Reconstruction) -> list[list[float]]:
    """x and y at rest, then x and y now, of each visible marker, px."""
    if (flow := result.markers) is None:
        return []
    rows = np.concatenate([flow.rest_px, flow.now_px], axis=1)[flow.seen]
    return [[round(float(value), 2) for value in row] for row in rows]


class Snapshots:
    """The last kept frames, by number; files are made when they are downloaded."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[int, Shown] = OrderedDict()
        self._count = 0

    @staticmethod
    def names(shown: Shown) -> list[str]:
        """The files that a snapshot of a frame has here; the picture needs matplotlib, the surface a scale."""
        result = shown.result
        there = (
            True,
            result is not None,
            result is not None and result.mm_per_px is not None,
            result is not None and find_spec("matplotlib") is not None,
        )
        return [name for name, is_there in zip(SNAPSHOT_FILES, there) if is_there]

    def add(self, shown: Shown) -> int:
        """Keep a frame; return its number. Beyond 16 frames the oldest is dropped."""
        with self._lock:
            self._count += 1
            self._kept[self._count] = shown
            while len(self._kept) > KEPT_SNAPSHOTS:
                self._kept.popitem(last=False)
            return self._count

    def file(self, number: int, name: str) -> tuple[str, bytes]:
        """Name and content of a file of a snapshot.

        These are frame.png, as the camera gave it; result.npz, for `gelform.load_result`; surface.ply, in mm; picture.png.

        Raises
        ------
        GelformError
            The snapshot or the file does not exist, or the frame has no result.
        """
        with self._lock:
            shown = self._kept.get(number)
        if shown is None or name not in SNAPSHOT_FILES:
            raise GelformError("This snapshot is no longer kept. Take another one.")
        if name == "frame.png":
            content = picture_bytes(shown.frame.image)
        elif shown.result is None:
            raise GelformError("This frame has no result, because it had no usable calibration.")
        elif name == "picture.png":
            content = picture_bytes(picture(shown.result, shown.image))
        else:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / name
                (save_result if name == "result.npz" else save_surface)(shown.result, path)
                content = path.read_bytes()
        return f"gelform-{number:03d}-{name}", content
