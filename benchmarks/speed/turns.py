"""One version's turns: its name of a call comes on a line, its milliseconds go back. Runs with that version's sources.

Versions differ in their parts: each calibrates by itself, lists the calls that it has, and takes the switches that it knows.
"""

from __future__ import annotations

import json
import runpy
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import gelform

# Whatever can be asked of a result, so that what a version computes on demand is computed.
MAPS = ("depth_mm", "depth_sigma_mm", "gradients_sigma", "confidence", "contact", "health")
ASKED = (*MAPS, "contacts", "outside_change", "curl_rms")
IMAGES = 24  # in the stream


class Images:
    """Images as a source that a stream reads to its end."""

    live, serial, rate_hz, name = False, None, 60.0, "images"

    def __init__(self, images: list[np.ndarray]) -> None:
        self.images, self.settings = images, {}

    def __iter__(self) -> Iterator[Any]:
        return (gelform.Frame(image, k / self.rate_hz, 0, k) for k, image in enumerate(self.images))

    def close(self) -> None:
        pass


def calibrated(presses: Any, every: int, file: Path) -> gelform.Calibration:
    """The calibration in a file; without one, that of every so many presses, kept there."""
    if not file.is_file():
        made = gelform.calibrate(replace(presses, presses=presses.presses[::every]))
        made.save(partial := file.with_suffix(".partial.npz"))
        partial.replace(file)
    return gelform.load_calibration(file)


def calls_of(
    name: str, calibration: Any, image: np.ndarray, images: list[np.ndarray]
) -> dict[str, Callable[[], float]]:
    """The calls of one frame by name; each returns the milliseconds that it took."""
    calls = {}
    for alone, solver in (("", "auto"), ("depth alone, ", "multigrid"), ("depth alone, ", "dct")):
        reconstruct = reconstructor(calibration, solver, bool(alone))
        asked = ASKED[: 1 if alone else None]
        if reconstruct is not None:
            calls[f"{name}: {alone + solver if alone else 'everything'}"] = cpu_ms(
                lambda reconstruct=reconstruct, asked=asked: ask(reconstruct.from_image(image), asked)
            )
    whole = gelform.Reconstructor(calibration)
    calls[f"{name}: bare loop, wall"] = lambda: wall_ms((whole(image) for image in images), len(images))
    calls[f"{name}: stream, wall"] = lambda: wall_ms(gelform.stream(Images(images), calibration), len(images))
    return calls


def stages_of(
    version: Path, name: str, calibration: Any, image: np.ndarray
) -> dict[str, Callable[[], float]]:
    """The parts of a frame that this version's own speed.py times; none where that does not run."""
    try:
        parts = runpy.run_path(str(version / "benchmarks/speed.py"))["stages"](calibration, image)
    except Exception as problem:  # the table of an old version may not fit its own code
        print(f"{version.name}: no stages, {problem!r}", file=sys.stderr)
        return {}
    return {f"{name}: {k}": cpu_ms(v) for k, v in parts.items() if not k.startswith("whole frame")}


def reconstructor(calibration: Any, solver: str, alone: bool) -> gelform.Reconstructor | None:
    """One for everything, or for depth alone with as little else as this version allows; None if it has no such solver."""
    for off in (("depth_sigma", "slope_sigma"), ("depth_sigma",), ()) if alone else ((),):
        try:
            return gelform.Reconstructor(calibration, solver=solver, **dict.fromkeys(off, False))
        except (TypeError, ValueError):  # a switch or a solver that this version does not have
            continue
    return None


def ask(result: Any, names: tuple[str, ...]) -> None:
    """Read these of a result, as far as this version has them."""
    for name in names:
        getattr(result, name, None)


def cpu_ms(call: Callable[[], Any]) -> Callable[[], float]:
    """The call, which returns milliseconds of this process: other processes take none of them."""

    def timed() -> float:
        started = time.process_time_ns()
        call()
        return (time.process_time_ns() - started) / 1e6

    return timed


def wall_ms(results: Any, count: int) -> float:
    """Milliseconds for each of so many results with their contact and depth sigma."""
    started = time.perf_counter()
    for result in results:
        ask(result, ("contact", "depth_sigma_mm"))
    return 1e3 * (time.perf_counter() - started) / count


def main() -> None:
    asked = json.loads(sys.argv[1])
    version = Path(asked["version"])
    sys.path[0] = str(version / "benchmarks")
    from report import dct_pair  # that version's own

    cv2.setNumThreads(1)
    calls = {"D": cpu_ms(dct_pair((240, 320)))}
    for folder, shown, file in asked["frames"]:
        presses, name, image = gelform.read_presses(folder), Path(folder).name, np.load(shown)
        presses = replace(presses, presses=tuple(sorted(presses.presses, key=lambda press: press.name)))
        calibration = calibrated(presses, asked["every"], Path(file))
        calls |= calls_of(name, calibration, image, [press.image for press in presses.presses[:IMAGES]])
        if asked["stages"]:
            calls |= stages_of(version, name, calibration, image)
    print(json.dumps({"from": gelform.__file__, "calls": list(calls)}), flush=True)
    for line in sys.stdin:
        count, call = line.rstrip().split(" ", 1)
        print(json.dumps([calls[call]() for _ in range(int(count))]), flush=True)


if __name__ == "__main__":
    main()
