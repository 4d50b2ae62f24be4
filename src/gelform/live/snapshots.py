"""Files of one displayed frame: result, image, depth, points."""

from __future__ import annotations

import io
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError, GelformError
from gelform.exchange.exporters.quantised import levels_from_depth
from gelform.foundations.checks import check_mm_per_px
from gelform.live.shown import Shown
from gelform.result import Reconstruction, save_result

KEPT = 16  # snapshots that are kept
_POINT = np.dtype([(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz", "confidence")])


class Snapshots:
    """The last kept frames, by number; files are made when they are downloaded."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[int, Shown] = OrderedDict()
        self._count = 0

    def add(self, shown: Shown) -> int:
        """Keep a frame; return its number. Beyond 16 frames the oldest is dropped."""
        with self._lock:
            self._count += 1
            self._kept[self._count] = shown
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
            return self._count

    def names(self, number: int) -> list[str]:
        """The names of a snapshot's files."""
        shown = self._kept[number]
        lacking = {"background.png"} if shown.background is None else set()
        lacking |= {"zero.npy"} if shown.zero_mm is None else set()
        if shown.result is None:
            lacking |= FILES.keys() - {"frame.png"}
        return [name for name in FILES if name not in lacking]

    def file(self, number: int, name: str) -> tuple[str, bytes]:
        """Name and content of one file of a snapshot.

        Raises
        ------
        GelformError
            The snapshot or the file does not exist, or the frame has no result.
        """
        with self._lock:
            shown = self._kept.get(number)
        if shown is None or name not in FILES:
            raise GelformError("This snapshot is no longer kept. Take another one.")
        return f"gelform-{number:03d}-{name}", FILES[name](shown)


def result_npz(shown: Shown) -> bytes:
    """The result, for `gelform.load_result`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "result.npz"
        save_result(_result(shown), path)
        return path.read_bytes()


def frame_png(shown: Shown) -> bytes:
    """The frame from the camera, for `gelform reconstruct`."""
    return _png(np.ascontiguousarray(shown.frame.image[..., ::-1]))


def depth_png(shown: Shown) -> bytes:
    """Depth with 16 bits: depth_mm = (v - 32768) x 1e-4, or 0 where unknown.

    Raises
    ------
    DataError
        Depth is beyond 3.2767 mm.
    """
    result = _result(shown)
    return _png(levels_from_depth(result.depth_mm, result.known))


def points_ply(shown: Shown) -> bytes:
    """Points and normals in mm, right-handed: x right, y down, z away from the camera, (x, y, -depth)."""
    result = _result(shown)
    height, width = result.shape
    pitch_x, pitch_y = check_mm_per_px(result.mm_per_px) if result.mm_per_px is not None else (1.0, 1.0)
    points = np.empty((height, width), dtype=_POINT)
    points["x"] = (np.arange(width, dtype=np.float32) * np.float32(pitch_x))[None, :]
    points["y"] = (np.arange(height, dtype=np.float32) * np.float32(pitch_y))[:, None]
    points["z"] = -result.depth
    points["nx"], points["ny"], points["nz"] = (result.normals[..., k] * (1, 1, -1)[k] for k in range(3))
    points["confidence"] = result.confidence
    kept = points[result.known]
    fields = "".join(f"property float {name}\n" for name in _POINT.names or ())
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {kept.size}\n{fields}end_header\n"
    return header.encode() + kept.tobytes()


def background_png(shown: Shown) -> bytes:
    """The background taken on the page, for `gelform reconstruct --background`."""
    if shown.background is None:
        raise GelformError("No background was taken on the page. The calibration has its own.")
    return _png(np.rint(shown.background[..., ::-1]).astype(np.uint8))


def zero_npy(shown: Shown) -> bytes:
    """The depth that was set as zero on the page, mm, for `numpy.load`."""
    if shown.zero_mm is None:
        raise GelformError("No zero was set on the page.")
    content = io.BytesIO()
    np.save(content, shown.zero_mm, allow_pickle=False)
    return content.getvalue()


FILES: dict[str, Callable[[Shown], bytes]] = {
    "result.npz": result_npz,
    "frame.png": frame_png,
    "depth.png": depth_png,
    "points.ply": points_ply,
    "background.png": background_png,
    "zero.npy": zero_npy,
}


def _result(shown: Shown) -> Reconstruction:
    if shown.result is None:
        raise GelformError("This frame has no result, because it had no usable calibration.")
    return shown.result


def _png(pixels: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    done, png = cv2.imencode(".png", pixels)
    if not done:
        raise DataError(f"OpenCV cannot encode {pixels.shape[0]}x{pixels.shape[1]} px as PNG.")
    return png.tobytes()
