"""Images of a whole camera: time and memory of a frame, and of a calibration on twelve presses, each in its own process."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import gelform
from report import dct_pair
from speed.turns import EVERYTHING, read

SHAPE = (2464, 3280)  # of a camera of 8 megapixels
PRESSES, NOISE = 12, 1.5  # images, gray levels
ROUNDS = 5


def enlarged(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """An image at the large size, with a camera's noise in each pixel."""
    large = cv2.resize(image, SHAPE[::-1], interpolation=cv2.INTER_CUBIC).astype(np.float32)
    large += NOISE * rng.standard_normal(large.shape, dtype=np.float32)
    return np.clip(np.rint(large), 0, 255).astype(np.uint8)


def measured(folder: Path) -> dict[str, Any]:
    """The figures of `task`s on a press folder of small images."""
    found: dict[str, Any] = {"shape": list(SHAPE), "presses": PRESSES}
    paths = os.pathsep.join(filter(None, (str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH"))))
    environment = os.environ | {"PYTHONPATH": paths}
    for task in ("calibration", "depth", "everything"):
        command = [sys.executable, "-m", "speed.large", task, str(folder)]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, env=environment)
        found |= json.loads(done.stdout)
    return found


def task(name: str, folder: Path) -> dict[str, Any]:
    """One process's figures; memory is its highest above what it held before."""
    cv2.setNumThreads(1)
    rng, small = np.random.default_rng(0), gelform.read_presses(folder)
    if name == "calibration":
        chosen = small.subset(range(PRESSES))
        large = replace(
            chosen,
            presses=tuple(replace(press, image=enlarged(press.image, rng)) for press in chosen.presses),
            background=enlarged(small.background, rng).astype(np.float32),
            mm_per_px=small.mm_per_px * small.image_shape[0] / SHAPE[0],
        )
        before, start = _peak_mb(), time.process_time()
        gelform.calibrate(large).save(folder / "large.npz", overwrite=True)
        spent = time.process_time() - start
        return {"calibration_cpu_s": spent, "calibration_memory_mb": _peak_mb() - before}
    reconstruct, maps = (
        gelform.Reconstructor(folder / "large.npz"),
        EVERYTHING if name == "everything" else ("depth_mm",),
    )
    image, pair = enlarged(small.presses[0].image, rng), dct_pair(SHAPE)
    pair()
    before = _peak_mb()
    times: list[list[float]] = [[], []]
    for _ in range(ROUNDS):  # in turn, because the machine's other work changes
        for of, work in zip(times, (pair, lambda: read([reconstruct.from_image(image)], maps))):
            start = time.process_time()
            work()
            of.append(1e3 * (time.process_time() - start))
    unit, spent = (float(np.median(of)) for of in times)
    return {name: {"ms": spent, "D": spent / unit, "memory_mb": _peak_mb() - before}}


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    print(json.dumps(task(sys.argv[1], Path(sys.argv[2]))))
