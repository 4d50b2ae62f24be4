"""Frames a second of a batch of PNG files, the memory of its workers, and how long going on takes.

    python benchmarks/batch.py            # 20,000 frames of 240x320; writes results/batch.json
    python benchmarks/batch.py --quick    # 100 frames, writes nothing; the start of the processes counts

Input and output lie in a temporary folder (TMPDIR). The frames are a simulated sensor's, a few different ones under many
names, so that making them takes no longer than reading them.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import gelform
from gelform.batch import BatchSettings, verify_output
from gelform.batch.inputs.listing import listing_of
from gelform.batch.inputs.plan import plan_of
from gelform.batch.records import COLUMNS, PartRecord, write_record
from gelform.batch.run import BatchSummary, _not_done
from gelform.exporters.folders import write_png
from gelform.exporters.press_folder import save_simulated_presses
from gelform.simulate import LAYOUTS, simulate_ball_presses
from report import table, write

SHAPE, DIFFERENT = (240, 320), 40
PER_FOLDER = 2000
SETTINGS = {
    "dct, depth only, npz": BatchSettings(keep=("depth",), solver="dct", depth_sigma=False),
    "dct, depth only, png": BatchSettings(form="png", solver="dct", depth_sigma=False),
    "weighted, npz": BatchSettings(),
    "weighted, without sigma, npz": BatchSettings(depth_sigma=False),
}
RATE = """
import sys, time, resource
from gelform.batch import run_batch
sys.path.insert(0, {here!r})
from batch import SETTINGS
if __name__ == "__main__":
    begin = time.perf_counter()
    summary = run_batch({source!r}, {calibration!r}, {output!r}, SETTINGS[{name!r}], workers={workers})
    seconds = time.perf_counter() - begin
    assert summary.complete and not summary.errors
    workers_kb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    print(summary.frames / seconds, workers_kb / 1024)
"""


def make_input(folder: Path, count: int) -> Path:
    """`count` PNG files of a simulated sensor, and its calibration; gives the calibration's path."""
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


def rate(folder: Path, calibration: Path, name: str, workers: int) -> dict[str, Any]:
    """Frames a second from the start of the run to its table, and the most that a worker's memory held."""
    with tempfile.TemporaryDirectory(dir=folder) as output:
        code = RATE.format(
            here=str(Path(__file__).parent),
            source=str(folder / "in"),
            calibration=str(calibration),
            output=str(Path(output) / "out"),
            name=name,
            workers=workers,
        )
        program = folder / "run.py"
        program.write_text(code)
        ran = subprocess.run([sys.executable, program], check=True, capture_output=True, text=True)
        frames_per_s, worker_mb = map(float, ran.stdout.split())
        verified = verify_output(Path(output) / "out")
        assert not verified[1]
        assert not verified[2]
    return {"settings": name, "workers": workers, "frames_per_s": frames_per_s, "worker_mb": worker_mb}


def going_on(folder: Path, entries: int) -> dict[str, Any]:
    """Seconds to list, plan and look at an output of many frames that is done; inputs and outputs are empty files."""
    source, output = folder / "many", folder / "many-out"
    for k in range(entries):
        path = source / f"{k // 10_000:04d}" / f"{k:08d}.png"
        if k % 10_000 == 0:
            path.parent.mkdir(parents=True)
            (output / "frames" / path.parent.name).mkdir(parents=True)
        os.close(os.open(path, os.O_CREAT))
    plan = plan_of(listing_of(source), 256)
    for part in plan:
        rows = [_row(part.sequence, name, part.start + k) for k, name in enumerate(part.names)]
        for row in rows:
            os.close(os.open(output / row["output"], os.O_CREAT))
        write_record(output, part.number, PartRecord(part.input_digest(), tuple(rows)))
    begin = time.perf_counter()
    plan = plan_of(listing_of(source), 256)
    listed_s = time.perf_counter() - begin
    todo = list(_not_done(output, plan, BatchSummary(), False))
    seconds = time.perf_counter() - begin
    assert not todo
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"entries": entries, "listing_s": listed_s, "resume_scan_s": seconds, "peak_mb": peak_mb}


def _row(sequence: str, name: str, index: int) -> dict[str, Any]:
    """As of a frame that was done; its output is empty here."""
    figures = {"deepest_mm": 0.123456789, "contact_mm2": 12.3456789, "volume_mm3": 1.23456789, "contacts": 1}
    where = {"sequence": sequence, "frame": name, "index": index, "output": f"frames/{sequence}/{name}.npz"}
    return {**dict.fromkeys(COLUMNS, ""), **where, **figures, "bytes": 0, "sha256": "0" * 64}


def measured(count: int, entries: int, workers: Sequence[int]) -> dict[str, Any]:
    """All of it in one temporary folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        calibration = make_input(folder, count)
        rates = [rate(folder, calibration, one, number) for one in SETTINGS for number in workers]
        return {"frames": count, "shape": SHAPE, "rates": rates, "going_on": going_on(folder, entries)}


def main() -> None:
    """Measure, print and, where it is not the quick mode, write."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    workers = [os.cpu_count() or 1]
    figures = measured(100, 1000, workers) if quick else measured(20_000, 1_000_000, workers)
    rows = [list(one.values()) for one in figures["rates"]]
    print(table(("settings", "workers", "frames/s", "MB of a worker"), rows))
    print(table(tuple(figures["going_on"]), [list(figures["going_on"].values())]))
    if not quick:
        write("batch", figures)


if __name__ == "__main__":
    main()
