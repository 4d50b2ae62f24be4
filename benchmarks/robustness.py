"""Hostile calls of the command line, and frames that lie otherwise than the calibration's.

    python benchmarks/robustness.py                             # about 10 minutes; writes results/robustness.json
    python benchmarks/robustness.py cli --calls 2000 --seed 7   # others than the recorded ones; writes nothing

`cli` makes calls of every command with odd arguments and damaged inputs. A call may end well, or in a sentence and status 1
or 2; status 70, a traceback, a signal or a hang is a fault, and makes the script's own status 1. `orientation` shows the
Reconstructor real presses and backgrounds of four sets in the 47 wrong readings (below GELFORM_DATA, default
../shared/data). `library` runs the properties of tests/robustness: every case ends in an error of gelform's own, a finding,
or a right result.
"""

from __future__ import annotations

import multiprocessing
import os
import re
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import cv2  # noqa: E402

import gelform  # noqa: E402
from gelform.cli import main as run_command  # noqa: E402
from gelform.errors import CalibrationError  # noqa: E402
from gelform.image.agreement import READINGS, Orientation  # noqa: E402
from hostile.calls import TRACEBACK, inputs_in, is_fault, made_calls  # noqa: E402
from hostile.commands import prepare  # noqa: E402
from presses import DATA, data_is_missing  # noqa: E402
from real_frames.faults import lying  # noqa: E402
from report import command_line, parts_asked, recorded, table, write  # noqa: E402

CALLS, SEED = 500, 36
LONGEST_S, MOST_BYTES = 240, 8 << 30  # of a call; a bomb of files or numbers stops there
SETS = ("mini-ball", "digit-ball", "gelslim", "mini-d")
SUMMARY = re.compile(r"robustness: (\d+) cases: (.*)")


def environment_of(here: Path) -> dict[str, str]:
    return {
        "HOME": str(here / "home"),
        "XDG_DATA_HOME": str(here / "home"),
        "XDG_CACHE_HOME": str(here / "home"),
    }


def serve(pipe: Any) -> None:
    """Run the calls that come through a pipe, in this process, and answer with status and what was said."""
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    with tempfile.TemporaryFile() as said:
        for descriptor in (1, 2):
            os.dup2(said.fileno(), descriptor)
        while True:
            call, here = pipe.recv()
            os.environ.update(environment_of(here))
            os.chdir(here)
            said.seek(0)
            said.truncate()
            status: Any = 0
            try:
                run_command(call)
            except SystemExit as stopped:
                status = stopped.code or 0
            except BaseException as problem:
                status = f"{TRACEBACK}: {type(problem).__name__}: {problem}"
            sys.stdout.flush()
            sys.stderr.flush()
            said.seek(0)
            pipe.send((status, said.read().decode("utf-8", "replace")))


class Server:
    """A process that runs calls; another one takes its place after a fault of it."""

    def __init__(self) -> None:
        self.process: Any = None

    def __call__(self, call: list[str], here: Path) -> tuple[Any, str]:
        if self.process is None:
            self.pipe, theirs = multiprocessing.Pipe()
            self.process = multiprocessing.get_context("fork").Process(
                target=serve, args=(theirs,), daemon=True
            )
            self.process.start()
            theirs.close()
        self.pipe.send((call, here))
        try:
            if self.pipe.poll(LONGEST_S):
                return self.pipe.recv()
            said = f"no end within {LONGEST_S} s"
        except EOFError:
            said = "the process died"
        self.process.kill()
        self.process.join()
        status, self.process = self.process.exitcode, None
        return status if said == "the process died" else "hang", said


def alone(call: list[str], here: Path) -> tuple[Any, str]:
    """The same call in a process of its own, for what the shared one said."""
    shutil.rmtree(here / "out")
    (here / "out").mkdir()
    prepare(here / "out")
    try:
        command = [sys.executable, "-m", "gelform", *call]
        surroundings = {**os.environ, **environment_of(here)}
        done = subprocess.run(command, cwd=here, env=surroundings, capture_output=True, timeout=LONGEST_S)
    except subprocess.TimeoutExpired:
        return "hang", f"no end within {LONGEST_S} s"
    except (ValueError, OSError) as problem:  # no system passes it on
        return 2, str(problem)
    return done.returncode, (done.stdout + done.stderr).decode("utf-8", "replace")


def cli(count: int, seed: int) -> dict[str, Any]:
    """Calls by their status, and the faults, each tried again alone."""
    ended: Counter[str] = Counter()
    faults: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="hostile-inputs-") as folder:
        cv2.setNumThreads(1)  # its threads do not survive a fork
        template, server = inputs_in(Path(folder) / "work"), Server()
        for call, here in made_calls(template, Path(folder), count, seed):
            status, said = server(call, here)
            if is_fault(status, said):
                status, said = alone(call, here)
            ended[str(status)] += 1
            if is_fault(status, said):
                last = said.strip().splitlines()[-1:] or [""]
                faults.append({"call": shlex.join(call)[:400], "status": str(status), "said": last[0][:400]})
                print(f"  {faults[-1]}", flush=True)
    print("\n" + table(["calls by status", "number"], sorted(ended.items())))
    return {"calls": count, "seed": seed, "by status": dict(sorted(ended.items())), "faults": faults}


def orientation() -> dict[str, Any]:
    """Real presses and backgrounds in the 47 wrong readings: how the Reconstructor answers them, by set."""
    figures: dict[str, Any] = {}
    for name in SETS:
        presses = gelform.read_presses(DATA / name)
        some = presses.subset(range(0, len(presses.presses), 2))
        calibration = gelform.calibrate(some, color_model="polynomial", start=None)
        reconstruct = gelform.Reconstructor(calibration)
        ended: Counter[str] = Counter()
        for reading in READINGS[1:]:
            for press in presses.presses[1::8]:
                ended[answer(reading, reconstruct.from_image, lying(press.image, reading))] += 1
            other = lying(presses.background, reading)
            ended[answer(reading, partial(gelform.Reconstructor, calibration), other)] += 1
        total = sum(ended.values())
        figures[name] = {"images": total, "named rightly, %": 100 * ended["named"] / total, **ended}
    shown = (
        "images",
        "named rightly, %",
        "named",
        "refused otherwise",
        "with a finding",
        "accepted silently",
    )
    rows = [[name, *(found.get(one, 0) for one in shown)] for name, found in figures.items()]
    print("\n" + table(["47 wrong readings", *shown], rows))
    return figures


def answer(reading: Orientation, call: Callable[[Any], Any], image: Any) -> str:
    """How a call ends with an image that lies so."""
    try:
        result = call(image)
    except (CalibrationError, ValueError) as problem:
        return "named" if f"is {reading.named} compared" in str(problem) else "refused otherwise"
    return "with a finding" if getattr(result, "health", ()) else "accepted silently"


def library(seed: int) -> dict[str, Any]:
    """The cases of tests/robustness by their ending, and the faults."""
    with tempfile.TemporaryDirectory() as folder:
        names = ("arrays", "files", "frames")
        tests = [f"tests/robustness/test_{name}.py" for name in names]
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            f"--basetemp={folder}/temporary",
            *tests,
        ]
        surroundings = {**os.environ, "GELFORM_ROBUSTNESS_FACTOR": "1.01"}  # above 1, the seed counts
        done = subprocess.run(
            [*command, f"--hypothesis-seed={seed}"],
            cwd=ROOT,
            env=surroundings,
            capture_output=True,
            text=True,
        )
    match = SUMMARY.search(done.stdout)
    if match is None:
        raise SystemExit(f"The suite itself failed:\n{done.stdout[-3000:]}{done.stderr[-1000:]}")
    ended = {name: int(count) for name, count in (one.rsplit(" ", 1) for one in match[2].split(", "))}
    complaints = sorted({line for line in done.stdout.splitlines() if line.startswith("FAILED")})
    print(f"\nlibrary: {match[1]} cases: {match[2]}", *complaints, sep="\n")
    return {"cases": int(match[1]), "seed": seed, "ended": ended, "faults": complaints}


def main() -> None:
    """Run the named parts, or all."""
    command = command_line(__doc__)
    command.add_argument("--calls", type=int, default=CALLS)
    command.add_argument("--seed", type=int, default=SEED)
    asked = parts_asked(command, ("cli", "orientation", "library"))
    figures = recorded("robustness")
    for name in asked.parts:
        if name == "orientation":
            if not data_is_missing(name):
                figures[name] = orientation()
        else:
            figures[name] = cli(asked.calls, asked.seed) if name == "cli" else library(asked.seed)
        if (asked.calls, asked.seed) == (CALLS, SEED):
            write("robustness", figures)
    raise SystemExit(1 if any(figures.get(name, {}).get("faults") for name in asked.parts) else 0)


if __name__ == "__main__":
    main()
