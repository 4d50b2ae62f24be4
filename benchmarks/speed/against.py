"""The frame of this checkout against that of another commit: both run in turn, so that a noisy machine slows both alike."""

from __future__ import annotations

import hashlib
import json
import os
import resource
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock

from report import table

ROOT = Path(__file__).resolve().parents[2]
KEPT = Path(tempfile.gettempdir()) / "gelform-speed"  # built commits, and calibrations by each version
LOOP, STREAM, FIRST = "bare loop, wall", "stream, wall", "first frame of a process"
WHOLE = ("everything", "depth alone, multigrid", "depth alone, dct")
Times = dict[str, tuple[list[float], list[float]]]
NATIVE = ("native", "hatch_build.py", "src/gelform/__init__.py")  # what a library of kernels is made from


def digest(folder: Path, *parts: str) -> str:
    """Of the names and bytes of the files in these parts, without what is built from them."""
    files = [
        f
        for part in parts
        for f in ([folder / part] if (folder / part).is_file() else (folder / part).rglob("*"))
    ]
    total = hashlib.sha256()
    for file in sorted(f for f in files if f.is_file() and f.suffix not in (".so", ".dll", ".pyc")):
        total.update(str(file.relative_to(folder)).encode() + b"\0" + file.read_bytes())
    return total.hexdigest()[:16]


def built(ref: str) -> Path:
    """A folder with that commit and its kernels, which are this checkout's where their sources are the same."""
    name = ["git", "rev-parse", "--verify", "--quiet", f"{ref}^{{commit}}"]
    commit = subprocess.run(name, cwd=ROOT, capture_output=True, text=True).stdout.strip()
    if not commit:
        raise SystemExit(f"Expected --against to name a commit, got {ref!r}.")
    KEPT.mkdir(exist_ok=True)
    target = KEPT / commit[:12]
    with FileLock(KEPT / "lock"):
        if not target.is_dir():
            partial = Path(tempfile.mkdtemp(dir=KEPT))
            archive = subprocess.Popen(["git", "archive", commit], cwd=ROOT, stdout=subprocess.PIPE)
            with tarfile.open(fileobj=archive.stdout, mode="r|") as files:
                files.extractall(partial, filter="data")
            if digest(partial, *NATIVE) == digest(ROOT, *NATIVE):
                for library in (ROOT / "src/gelform/_native").glob("kernels_*"):
                    shutil.copy(library, partial / "src/gelform/_native")
            else:
                subprocess.run([sys.executable, "hatch_build.py"], cwd=partial, check=True)
            partial.rename(target)
    return target


class Turns:
    """A process with one version: `ms(call)` lets it run a call a few times."""

    def __init__(self, version: Path, frames: list[tuple[Path, Path]], quick: bool) -> None:
        sources, every = digest(version, "src", "native"), 6 if quick else 3
        self.version = version
        self.files = [KEPT / f"{sources}-{digest(f, '.')}-{every}.npz" for f, _ in frames]
        asked = {
            "version": version,
            "every": every,
            "stages": not quick,
            "frames": [(*f, file) for f, file in zip(frames, self.files)],
        }
        command = [sys.executable, Path(__file__).with_name("turns.py"), json.dumps(asked, default=str)]
        self._process = subprocess.Popen(
            command, env=self.environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def environment(self) -> dict[str, str]:
        return {**os.environ, "PYTHONPATH": str(self.version / "src")}

    def calls(self) -> list[str]:
        """The names of its calls; waits until it has calibrated."""
        ready = self._answer()
        assert Path(ready["from"]).is_relative_to(self.version / "src"), ready
        return list(ready["calls"])

    def ms(self, call: str, count: int) -> list[float]:
        self._process.stdin.write(f"{count} {call}\n")
        self._process.stdin.flush()
        return list(self._answer())

    def close(self) -> None:
        self._process.terminate()
        self._process.wait()

    def _answer(self) -> Any:
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"{self.version} ended with {self._process.wait()}, see above.")
        return json.loads(line)


def first_frame_s(calibration: Path, image: Path, environment: dict[str, str]) -> float:
    """Seconds of CPU from the start of a new Python process to its first result."""
    code = (
        "import sys, gelform, numpy; gelform.Reconstructor(sys.argv[1]).from_image(numpy.load(sys.argv[2]))"
    )
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", code, calibration, image], env=environment, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def compare(ref: str, frames: list[tuple[Path, Path]], *, quick: bool) -> None:
    """Print each part of frames (presses to calibrate with, an image) by that commit and this checkout, and a line."""
    versions = [Turns(version, frames, quick) for version in (built(ref), ROOT)]
    try:
        old, new = (turns.calls() for turns in versions)
        both = [call for call in new if call in old]
        slow = [call for call in both if call.endswith((LOOP, STREAM))]
        times = in_turn(versions, [call for call in both if call not in slow], 6 if quick else 40, 3)
        times |= in_turn(versions, slow, 4 if quick else 20, 1)
    finally:
        for turns in versions:
            turns.close()
    firsts: Times = {FIRST: ([], [])}
    for _ in range(3 if quick else 6):
        for turns, seconds in zip(versions, firsts[FIRST]):
            seconds.append(1e3 * first_frame_s(turns.files[-1], frames[-1][1], turns.environment()))
    times |= firsts
    unit = min(min(times["D"]))
    rows = [
        [call, *(f"{min(t):.2f} ({np.median(t):.2f})" for t in (old, new)), f"{min(new) / unit:.1f}"]
        + [f"{of(new) / of(old):.2f}" for of in (min, np.median)]
        for call, (old, new) in times.items()
    ]
    print(table(["part", "old, ms (median)", "new, ms (median)", "new, D", "ratio", "of medians"], rows))
    print(
        f"{ref} -> this checkout: "
        + "; ".join([*(note(times, f.name) for f, _ in frames), said(times, FIRST)])
    )


def in_turn(versions: list[Turns], calls: list[str], seconds: float, count: int) -> Times:
    """The milliseconds of each call by each version, which take turns, and turns in being the first."""
    times: Times = {call: ([], []) for call in calls}
    end, rounds = time.monotonic() + seconds, 0
    while rounds < 4 or time.monotonic() < end:
        rounds += 1
        for call in calls:
            for turns, ms in list(zip(versions, times[call]))[:: (-1) ** rounds]:
                ms += turns.ms(call, count)
    return times


def note(times: Times, frame: str) -> str:
    """The whole of a frame in words."""
    parts = [said(times, name) for name in times if name.startswith(f"{frame}: ") and name.endswith(WHOLE)]
    loop, stream = times[f"{frame}: {LOOP}"], times[f"{frame}: {STREAM}"]
    rates = [f"{min(loop[k]) / min(stream[k]):.2f}" for k in (0, 1)]
    return f"frame, {', '.join(parts).replace(f'{frame}: ', '')}, stream {' -> '.join(rates)} of a bare loop"


def said(times: Times, name: str) -> str:
    old, new = map(min, times[name])
    return f"{name} old {old:.1f} ms, new {new:.1f} ms, ratio {new / old:.2f}"
