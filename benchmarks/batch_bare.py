"""What a rate of a batch is held against: a bare loop over the same images in as many processes. See `batch.py`.

It reads an image, takes two of its channels for slopes, solves for depth by cosines and saves it: no color model, no
confidence, no contacts, no digests, nothing flushed, nothing to go on from.
"""

from __future__ import annotations

import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import cv2
import numpy as np

from gelform.solvers import SOLVERS

PIECE = 256  # images, as a part of a batch


def bare_loop(paths: list[Path], output: Path) -> int:
    """Depth of images, each saved as npz; how many."""
    cv2.setNumThreads(1)
    solve = SOLVERS["dct"](cv2.imread(str(paths[0])).shape[:2], (0.06, 0.06))
    for path in paths:
        image = cv2.imread(str(path)).astype(np.float32)
        gradients = np.ascontiguousarray(image[..., :2] / 255 - 0.5)
        np.savez(output / f"{path.stem}.npz", depth_mm=solve(gradients).depth_mm)
    return len(paths)


def bare_rate(source: Path, output: Path, workers: int) -> float:
    """Frames a second of the loop, from the start of its processes."""
    output.mkdir()
    begin = time.perf_counter()
    paths = sorted(source.rglob("*.png"))
    pieces = [paths[k : k + PIECE] for k in range(0, len(paths), PIECE)]
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        done = sum(pool.map(bare_loop, pieces, [output] * len(pieces)))
    assert done == len(paths)
    return done / (time.perf_counter() - begin)
