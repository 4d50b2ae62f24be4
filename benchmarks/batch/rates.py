"""Frames per second of a batch, compared with a bare loop over the same images in as many processes.

The bare loop reads an image, takes two of its channels for slopes, solves for depth by cosines and saves it. It has no color
model, confidence, contacts, digests or flushing, and cannot be resumed.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import gelform
from gelform.batch import BatchSettings, verify_output
from gelform.depth.solvers import SOLVERS
from gelform.exchange.exporters.press_folder import save_simulated_presses, write_png
from gelform.simulate import LAYOUTS, simulate_ball_presses

SHAPE, DIFFERENT = (240, 320), 40
PER_FOLDER = 2000
WORKERS = os.cpu_count() or 1
SETTINGS = {
    "depth only, npz": BatchSettings(keep=("depth",)),
    "depth only, Zarr uint16": BatchSettings("zarr", dtype="uint16", keep=("depth",)),
    "depth only, png": BatchSettings("png", keep=("depth",)),
    "default, npz": BatchSettings(),
}
REACH_PER_S = {"default, npz": 250}
ON_RAY = "depth only, Zarr uint16"
RATE = """
import sys, time, resource
from gelform.batch import Engine, run_batch
source, calibration, output, name, engine, workers, here = sys.argv[1:]
sys.path.insert(0, here)
from batch.rates import SETTINGS
if __name__ == "__main__":
    begin = time.perf_counter()
    summary = run_batch(source, calibration, output, SETTINGS[name], engine=Engine(engine, int(workers)))
    seconds = time.perf_counter() - begin
    assert summary.complete and not summary.errors
    print(summary.frames / seconds, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024)
"""
PIECE = 256  # images, as a part of a batch


def make_input(folder: Path, count: int) -> Path:
    """Write `count` PNG files of a simulated sensor, and its calibration; return the calibration's path."""
    sensor = replace(LAYOUTS["three-edges"], shape=SHAPE, mm_per_px=0.0634, name="benchmark")
    presses = simulate_ball_presses(
        sensor, ball_diameters_mm=(6, 9), count=DIFFERENT, rng=np.random.default_rng(0), oversample=1
    )
    pressed = save_simulated_presses(folder / "presses", presses)
    gelform.calibrate(gelform.read_presses(pressed), color_model="polynomial").save(folder / "cal.npz")
    contents = []
    for k, press in enumerate(presses.presses):
        write_png(folder / f"{k}.png", press.image)
        contents.append((folder / f"{k}.png").read_bytes())
    for k in range(count):
        path = folder / "in" / f"{k // PER_FOLDER:04d}" / f"{k:07d}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(contents[k % DIFFERENT])
    return folder / "cal.npz"


def rate(folder: Path, source: Path, name: str, engine: str = "pool") -> dict[str, Any]:
    """Frames per second from the start of the run to its table, and the largest memory of a worker."""
    with tempfile.TemporaryDirectory(dir=folder) as output:
        program, written = folder / "run.py", Path(output) / "out"
        program.write_text(RATE)
        here = Path(__file__).parents[1]
        arguments = [source, folder / "cal.npz", written, name, engine, WORKERS, here]
        command = [sys.executable, program, *map(str, arguments)]
        ran = subprocess.run(command, check=True, capture_output=True, text=True)
        frames_per_s, worker_mb = map(float, ran.stdout.split())
        assert verify_output(written)[1:] == (0, [])
    measured = {"settings": name, "engine": engine, "workers": WORKERS, "frames_per_s": frames_per_s}
    return measured | ({"worker_mb": worker_mb} if engine == "pool" else {})


def rates(folder: Path, quick: bool) -> dict[str, Any]:
    """Rates of a bare loop, of each setting, and of Ray against the pool."""
    count = 1000 if quick else 20_000
    make_input(folder, count)
    bare = bare_rate(folder / "in", folder / "bare", WORKERS)
    shutil.rmtree(folder / "bare")
    rows = [rate(folder, folder / "in", name) for name in SETTINGS]
    rows = [row | {"of_bare": row["frames_per_s"] / bare} for row in rows]
    found: dict[str, Any] = {"frames": count, "shape": SHAPE, "reach_frames_per_s": REACH_PER_S, "rows": rows}
    found["bare_loop_frames_per_s"] = bare
    if find_spec("ray") is None:
        return found | {"ray": "not installed"}
    rows.append(rate(folder, folder / "in", ON_RAY, "ray"))
    pool = next(row for row in rows if row["settings"] == ON_RAY)
    return found | {
        "ray_over_pool": rows[-1]["frames_per_s"] / pool["frames_per_s"],
        "reach_ray_over_pool": 0.6,
    }


def bare_loop(paths: list[Path], output: Path) -> int:
    """Save the depth of images, each as npz; return their number."""
    cv2.setNumThreads(1)
    solve = SOLVERS["dct"](cv2.imread(str(paths[0])).shape[:2], (0.06, 0.06))
    for path in paths:
        image = cv2.imread(str(path)).astype(np.float32)
        gradients = np.ascontiguousarray(image[..., :2] / 255 - 0.5)
        np.savez(output / f"{path.stem}.npz", depth_mm=solve(gradients).depth_mm)
    return len(paths)


def bare_rate(source: Path, output: Path, workers: int) -> float:
    """Frames per second of the loop, from the start of its processes."""
    output.mkdir()
    begin = time.perf_counter()
    paths = sorted(source.rglob("*.png"))
    pieces = [paths[k : k + PIECE] for k in range(0, len(paths), PIECE)]
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        done = sum(pool.map(bare_loop, pieces, [output] * len(pieces)))
    assert done == len(paths)
    return done / (time.perf_counter() - begin)
