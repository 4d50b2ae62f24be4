"""How many kernels a frame calls, and the share of its time in them: there the interpreter's lock is free."""

from __future__ import annotations

import time
from typing import Any
from unittest.mock import patch

import numpy as np

import gelform
from gelform._native import Kernel
from speed.turns import EVERYTHING

FRAMES = 200
PARTS = {"depth alone": ("depth_mm",), "everything": EVERYTHING}


def kernel_calls(calibration: gelform.Calibration, image: np.ndarray) -> dict[str, Any]:
    """Of a frame's depth, and of everything: calls, and their share of the time.

    The time of each call and that before it are the least of many frames, so that other work on the machine counts little.
    """
    reconstruct, call = gelform.Reconstructor(calibration), Kernel.__call__
    marks: list[float] = []

    def marked(kernel: Kernel, *arguments: Any, **named: Any) -> int:
        marks.append(time.perf_counter())
        status = call(kernel, *arguments, **named)
        marks.append(time.perf_counter())
        return status

    def spans(maps: tuple[str, ...]) -> np.ndarray:
        """What lies before each call, and what each takes, in turn; and what follows the last."""
        marks[:] = [time.perf_counter()]
        result = reconstruct.from_image(image)
        for name in maps:
            getattr(result, name)
        return np.diff([*marks, time.perf_counter()])

    found = {}
    with patch.object(Kernel, "__call__", marked):
        for part, maps in PARTS.items():
            spans(maps)  # the first frame prepares what later ones share
            least = np.min([spans(maps) for _ in range(FRAMES)], axis=0)
            calls = least[1::2]
            found[part] = {"calls": len(calls), "share in kernels": float(calls.sum() / least.sum())}
    return found
