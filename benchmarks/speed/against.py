"""The frame of this checkout beside that of another commit. They take turns, so that a noisy machine slows both alike."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock

from report import table

ROOT = Path(__file__).resolve().parents[2]
KEPT = Path(tempfile.gettempdir()) / "gelform-speed"  # built commits, and calibrations by each version
NATIVE = ("native", "hatch_build.py", "src/gelform/__init__.py")  # what a library of kernels is made from
SAID = ("everything", "depth alone", "stream", "first")  # parts in the last line
Process = subprocess.Popen[str]


def compare(ref: str, frames: Sequence[tuple[Path, Path]], *, quick: bool) -> None:
    """Print the parts of frames, given as presses to calibrate with and an image, by both; the last line is for a note.

    Milliseconds are of a processor, which other processes take none of, except where "wall" is said.
    """
    processes = [start(root, frames, 6 if quick else 3) for root in (built(ref), ROOT)]
    times = in_turn(processes, seconds=6 if quick else 60, stages=not quick)
    unit, rows, said = min(min(times["D"])), [], []
    for call, both in times.items():
        (old, new), medians = map(min, both), [float(np.median(ms)) for ms in both]
        ratios = [f"{new / old:.2f}", f"{medians[1] / medians[0]:.2f}"]
        cells = [f"{old:.2f} ({medians[0]:.2f})", f"{new:.2f} ({medians[1]:.2f})", f"{new / unit:.1f}"]
        rows.append([call, *cells, *ratios])
        if call.split(", ", 1)[-1].startswith(SAID) and "wall" not in call:
            said.append(
                f"{call} old {old:.1f} ms, new {new:.1f} ms, ratio {ratios[0]} (min; {ratios[1]} of medians)"
            )
    print(table(["part", "old, ms (median)", "new, ms (median)", "new, D", "ratio", "of medians"], rows))
    print(f"Against {ref}: {'; '.join(said)}")


def start(root: Path, frames: Sequence[tuple[Path, Path]], every: int) -> Process:
    """A process with the sources in `root`, which calibrates on every so many presses, or did so before."""
    sources = digest(root, "src", "native")
    files = [KEPT / f"{sources}-{digest(folder, '.')}-{every}.npz" for folder, _ in frames]
    asked = json.dumps([root, every, [(*frame, file) for frame, file in zip(frames, files)]], default=str)
    command = [sys.executable, str(Path(__file__).with_name("turns.py")), asked]
    environment, pipe = {**os.environ, "PYTHONPATH": str(root / "src")}, subprocess.PIPE
    return Process(command, env=environment, stdin=pipe, stdout=pipe, text=True)


def answer(process: Process, call: str | None = None) -> list[Any]:
    """What a process says to the name of a call; at first where its sources lie, and the names."""
    if call is not None:
        print(call, file=process.stdin, flush=True)
    line = process.stdout.readline() if process.stdout else ""
    if not line:
        raise SystemExit("A version ended early; see above.")
    return list(json.loads(line))


def in_turn(
    processes: list[Process], seconds: float, stages: bool
) -> dict[str, tuple[list[float], list[float]]]:
    """The milliseconds of each call that both have. Each gets the same time, and 4 rounds at least, 12 if it is short."""
    old, new = (answer(process)[1:] for process in processes)
    both = [call for call in new if call in old and (stages or "stage: " not in call)]
    times: dict[str, tuple[list[float], list[float]]] = {call: ([], []) for call in both}
    left_s, rounds = dict.fromkeys(times, seconds / len(times)), 0
    while asked := [
        call
        for call, (ms, _) in times.items()
        if rounds < (12 if len(ms) > rounds else 4) or left_s[call] > 0
    ]:
        rounds += 1
        for call in asked:
            started = time.monotonic()
            for process, ms in list(zip(processes, times[call]))[:: (-1) ** rounds]:
                ms += answer(process, call)
            left_s[call] -= time.monotonic() - started
    return times


def built(ref: str) -> Path:
    """A folder with that commit and its kernels, which are this checkout's where their sources are the same."""
    named = ["git", "rev-parse", "--verify", "--quiet", f"{ref}^{{commit}}"]
    commit = subprocess.run(named, cwd=ROOT, capture_output=True, text=True).stdout.strip()
    if not commit:
        raise SystemExit(f"Expected --against to name a commit, got {ref!r}.")
    KEPT.mkdir(exist_ok=True)
    with FileLock(KEPT / "lock"):
        if not (root := KEPT / commit[:12]).is_dir():
            made = Path(tempfile.mkdtemp(dir=KEPT))
            parts = f"{commit} src native benchmarks hatch_build.py"
            subprocess.run(f"git archive {parts} | tar -x -C {made}", cwd=ROOT, shell=True, check=True)
            if digest(made, *NATIVE) != digest(ROOT, *NATIVE):
                subprocess.run([sys.executable, "hatch_build.py"], cwd=made, check=True)
            else:
                for library in (ROOT / "src/gelform/_native").glob("kernels_*"):
                    shutil.copy(library, made / "src/gelform/_native")
            made.rename(root)
    return root


def digest(folder: Path, *parts: str) -> str:
    """Of the names and bytes of the files in these parts of a folder, without what is built from them."""
    files = {f for part in parts for f in (folder / part, *(folder / part).rglob("*")) if f.is_file()}
    total = hashlib.sha256()
    for file in sorted(f for f in files if f.suffix not in (".so", ".dll", ".pyc")):
        total.update(str(file.relative_to(folder)).encode() + b"\0" + file.read_bytes())
    return total.hexdigest()[:16]
