"""Snapshots of displayed frames: the camera's frame and its result."""

from __future__ import annotations

import tempfile
import threading
from collections import OrderedDict
from pathlib import Path

import cv2

from gelform.errors import GelformError
from gelform.live.shown import Shown
from gelform.result import save_result

KEPT = 16  # snapshots that are kept


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

    def file(self, number: int, name: str) -> tuple[str, bytes]:
        """Name and content of a snapshot's frame.png, as the camera gave it, or result.npz, for `gelform.load_result`.

        Raises
        ------
        GelformError
            The snapshot or the file does not exist, or the frame has no result.
        """
        with self._lock:
            shown = self._kept.get(number)
        if shown is None or name not in ("frame.png", "result.npz"):
            raise GelformError("This snapshot is no longer kept. Take another one.")
        if name == "frame.png":
            content = cv2.imencode(".png", shown.frame.image[..., ::-1])[1].tobytes()
        elif shown.result is not None:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / name
                save_result(shown.result, path)
                content = path.read_bytes()
        else:
            raise GelformError("This frame has no result, because it had no usable calibration.")
        return f"gelform-{number:03d}-{name}", content
