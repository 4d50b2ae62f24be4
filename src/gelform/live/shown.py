"""The displayed data of one frame, encoded once for all clients as binary messages, and its numbers.

A message is magic bytes, the header's length, the header as JSON, then the planes, each aligned to 8 bytes: maps as
uint16 or uint8 levels, the image raw or as JPEG. There are two encodings. `raw` is for a browser on the same machine,
where bytes are cheap and time is not. `small` is for a network: the image as JPEG, maps at half the resolution, packed
with deflate.
"""

from __future__ import annotations

import json
import struct
import tempfile
import threading
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform import DataError, Frame, GelformError, Reconstruction, picture, save_result
from gelform.exchange.exporters.surface import MM_PER_LEVEL, ZERO_LEVEL, save_surface
from gelform.foundations.files import picture_bytes
from gelform.result.maps import MAP_PLANES
from gelform.result.record import ResultNumbers
from gelform.sensors.playback import ReplayedFrame
from gelform.slopes.budget import CAUSES, Explanation

ENCODINGS = ("raw", "small")
MAGIC = b"GFL1"
ALIGNMENT = 8  # bytes, required by typed arrays in the browser


@dataclass(frozen=True)
class Plane:
    """A map's bytes."""

    facts: dict[str, Any]  # name, kind, height, width, packed; zero and step if its numbers are scaled
    data: bytes


def image_plane(image: NDArray[Any], encoding: str) -> Plane:
    """The image (H, W, 3) RGB, 0-255: `raw` bytes or a JPEG."""
    pixels = np.ascontiguousarray(image, dtype=np.uint8)
    if encoding == "raw":
        return _plane("image", "rgb", pixels.shape, pixels.tobytes())
    done, jpeg = cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])
    if not done:
        raise DataError(f"OpenCV cannot encode an image of {pixels.shape[0]}x{pixels.shape[1]} px as JPEG.")
    return _plane("image", "jpeg", pixels.shape, jpeg.tobytes())


def depth_plane(depth: NDArray[np.float32], encoding: str) -> Plane:
    """Depth (H, W) as uint16 in steps of 1e-4 mm around 32768, or in larger steps if the range requires it.

    0 is never sent, because files use it for unknown pixels.
    """
    step = max(MM_PER_LEVEL, float(np.abs(depth).max(initial=0.0)) / 32767)
    levels = np.rint(depth * np.float32(1 / step)).astype(np.int32) + ZERO_LEVEL
    return number_plane(
        "depth", levels.clip(1, 65535).astype(np.uint16), encoding, zero=ZERO_LEVEL, step=step
    )


def level_plane(name: str, values: NDArray[Any], encoding: str, *, step: float = 1 / 255) -> Plane:
    """Values from 0 up (H, W) as uint8 in the given steps; values above 255 steps are clipped."""
    levels = np.rint(np.clip(values * np.float32(1 / step), 0, 255)).astype(np.uint8)
    return number_plane(name, levels, encoding, step=step)


def number_plane(name: str, numbers: NDArray[Any], encoding: str, *, zero: int = 0, step: float = 1) -> Plane:
    """Numbers (H, W), uint8 or uint16, of values (number - zero) * step, or sets of bits; `small`: every second pixel."""
    kind = f"u{8 * numbers.itemsize}"
    if encoding == "raw":
        data = np.ascontiguousarray(numbers).tobytes()
        return _plane(name, kind, numbers.shape, data, zero=zero, step=step)
    half = numbers[::2, ::2]
    # Differences along rows are small on a smooth surface; they compress three times better.
    steps = np.diff(half, axis=1, prepend=half.dtype.type(0))
    data = zlib.compress(np.ascontiguousarray(steps).tobytes(), 1)
    return _plane(name, kind, half.shape, data, packed=True, zero=zero, step=step)


def _plane(
    name: str, kind: str, shape: tuple[int, ...], data: bytes, *, packed: bool = False, **meaning: float
) -> Plane:
    facts = {"name": name, "kind": kind, "height": shape[0], "width": shape[1], "packed": packed}
    return Plane(facts | meaning, data)


def message(header: Mapping[str, Any], planes: Sequence[Plane]) -> bytes:
    """Bytes of a message.

    The header gains `planes`: for each its name, kind ("u8", "u16", "rgb", "jpeg"), height and width, whether it is packed
    ("deflate"), and `offset` and `length` in bytes from the end of the header. Number planes also have `zero` and
    `step`, with value = (number - zero) * step.
    """
    listed, parts, at = [], [], 0
    for plane in planes:
        listed.append({**plane.facts, "offset": at, "length": len(plane.data)})
        parts += [plane.data, b"\0" * (-len(plane.data) % ALIGNMENT)]
        at += len(plane.data) + len(parts[-1])
    text = json.dumps({**header, "planes": listed}, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-(len(MAGIC) + 4 + len(text)) % ALIGNMENT)
    return b"".join([MAGIC, struct.pack("<I", len(text)), text, *parts])


def read_message(data: bytes) -> tuple[dict[str, Any], dict[str, bytes]]:
    """The header and the bytes of each plane by name, for a client in Python; DataError: other bytes, or truncated."""
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


PLANES = ("image", "flags", "unknown", "causes", *MAP_PLANES)
CONTACT, KNOWN = 1, 2  # bits of the plane `flags`
SNAPSHOT_FILES = ("frame.png", "result.npz", "surface.ply", "picture.png")
KEPT_SNAPSHOTS = 16


def outlines_of(result: Reconstruction) -> list[list[int]]:
    """An outline of each contact, also of one inside a ring: x, y, x, y ... in px of the image; the 32 largest of many."""
    contours, inside = cv2.findContours(result.contact.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    parents = inside[0, :, 3] if contours else ()
    outer = [one for one, parent in zip(contours, parents) if parent < 0]  # no edges of holes
    largest = sorted(outer, key=len, reverse=True)[:32]
    # An outline is at most 0.6 px away from the edge of the pixels.
    return [cv2.approxPolyDP(outline, 0.6, True).ravel().tolist() for outline in largest]


@dataclass(eq=False)
class ShownFrame:
    """One frame of a station with its result, if there is one."""

    serial: int  # running number of the station's frames; larger is newer
    frame: Frame  # from the camera
    image: NDArray[np.uint8]  # (H, W, 3), after the view
    result: Reconstruction | None = None  # None: no calibration, or this frame could not be reconstructed
    explain: Callable[[], Explanation] | None = None  # on request, because it takes longer than a frame
    problem: str = ""  # why there is no result
    learn: Callable[[], None] | None = None  # learns from the result for the coming frames
    motion: dict[str, Any] | None = None  # since the object touched: `MovedSince`; None if nobody asks
    _made: dict[Any, Any] = field(default_factory=dict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def numbers(self) -> ResultNumbers | None:
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
            # One bit per cause, at pixels where it alone makes a slope less certain than a clean one.
            why = self.explain()
            bits = np.zeros(why.confidence.shape, np.uint16)
            for number, one in enumerate(why.maps.values()):
                bits[one > why.full_confidence_sigma] |= np.uint16(1 << number)
            return number_plane(name, bits, encoding)
        if name == "unknown" and not result.known.all():
            return number_plane(name, (~result.known).view(np.uint8), encoding)
        if name == "flags":
            flags = result.contact.view(np.uint8) * CONTACT + result.known.view(np.uint8) * KNOWN
            return number_plane(name, flags, encoding)
        return None

    def _header(self) -> dict[str, Any]:
        result, numbers = self.result, self.numbers
        facts: dict[str, Any] = {
            "serial": self.serial,
            "time_s": self.frame.time_s,
            "height": self.image.shape[0],
            "width": self.image.shape[1],
            "problem": self.problem,
        }
        if isinstance(self.frame, ReplayedFrame):
            facts["replay"] = [self.frame.number, self.frame.recorded_s]
        if result is None:
            return facts
        facts["health"] = [
            [finding.name, finding.message, float(finding.figure)] for finding in result.health
        ]
        if numbers is None:
            return facts | {"problem": " ".join(finding.message for finding in result.health)}
        pitch, markers = result.mm_per_px, result.markers
        rows: Any = [] if markers is None else np.hstack([markers.rest_px, markers.now_px])[markers.seen]
        return facts | {
            "unit": "px" if pitch is None else "mm",
            "mm_per_px": None if pitch is None else [float(p) for p in np.broadcast_to(pitch, 2)],
            **numbers.over_time,
            "peak_px": [numbers.x_px, numbers.y_px],
            "outlines": outlines_of(result),
            "contacts": [asdict(contact) for contact in result.contacts[:8]],
            # x and y at rest, then x and y now, of each visible marker, px.
            "markers": [[round(float(value), 2) for value in row] for row in rows],
            "force": None if result.force_model is None else result.force.columns(),
            "motion": self.motion,
            "causes": list(CAUSES),
            "cause_colors": [cause.color for cause in CAUSES.values()],
        }


class Snapshots:
    """The last kept frames, by number; files are made when they are downloaded."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: dict[int, ShownFrame] = {}
        self._count = 0

    @staticmethod
    def names(shown: ShownFrame) -> list[str]:
        """The files that a snapshot of a frame has here; the picture needs matplotlib, the surface a scale."""
        result, files = shown.result, ["frame.png"]
        if result is not None:
            files.append("result.npz")
            files += ["surface.ply"] if result.mm_per_px is not None else []
            files += ["picture.png"] if find_spec("matplotlib") is not None else []
        return files

    def add(self, shown: ShownFrame) -> int:
        """Keep a frame; return its number. Beyond 16 frames the oldest is dropped."""
        with self._lock:
            self._count += 1
            self._kept[self._count] = shown
            self._kept.pop(self._count - KEPT_SNAPSHOTS, None)
            return self._count

    def file(self, number: int, name: str) -> tuple[str, bytes]:
        """Name and content of a file of a snapshot: of the frame as the camera gave it, or of its result.

        GelformError: the snapshot or the file does not exist, or the frame has no result.
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
