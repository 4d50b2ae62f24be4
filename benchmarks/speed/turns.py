"""One version of gelform, which waits for its turn: the name of a call comes on a line, milliseconds go back.

Versions differ in their parts: each calibrates by itself, lists its calls, and takes the switches that it knows.
"""

from __future__ import annotations

import json
import os
import resource
import runpy
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import gelform

# All that can be asked of a result, so that what a version computes on demand is computed.
OF_STREAM = ("depth_mm", "depth_sigma_mm", "contact", "health")
EVERYTHING = (
    *OF_STREAM,
    "normals",
    "gradients_sigma",
    "confidence",
    "contacts",
    "outside_change",
    "curl_rms",
)
IMAGES = 24  # in a sequence
FIRST = "import sys, gelform, numpy; gelform.Reconstructor(sys.argv[1]).from_image(numpy.load(sys.argv[2]))"
Calls = dict[str, Callable[[], list[float]]]


class Images(list[np.ndarray]):
    """Images as a source that a stream reads to its end."""

    live, serial, rate_hz, name, settings = False, None, 60.0, "images", {}

    def __iter__(self) -> Any:
        return (gelform.Frame(image, k / 60, 0, k) for k, image in enumerate(super().__iter__()))

    def close(self) -> None:
        """A source can be closed."""


def whole_frames(calibration: gelform.Calibration, image: np.ndarray, images: Images) -> Calls:
    """A frame with everything and with as little besides depth as this version allows; a loop and a stream."""
    whole = depth = gelform.Reconstructor(calibration)
    for off in (("depth_sigma", "slope_sigma"), ("depth_sigma",)):
        try:
            depth = gelform.Reconstructor(calibration, **dict.fromkeys(off, False))
            break
        except TypeError:  # a switch that this version does not have
            continue

    sequences = {"loop": lambda: map(whole, images), "stream": lambda: gelform.stream(images, calibration)}
    clocks = {"": time.process_time, ", wall": time.perf_counter}
    return {
        "everything": timed(lambda: read([whole.from_image(image)], EVERYTHING)),
        "depth alone": timed(lambda: depth.from_image(image).depth_mm),
        **{
            f"{k} of frames{c}": partial(after_first, of, clocks[c])
            for c in clocks
            for k, of in sequences.items()
        },
    }


def after_first(results_of: Callable[[], Any], clock: Callable[[], float]) -> list[float]:
    """Milliseconds for each result after the first, which waits until all is prepared."""
    results = iter(results_of())
    read([next(results)], OF_STREAM)
    started = clock()
    count = read(results, OF_STREAM)
    return [1e3 * (clock() - started) / count]


def read(results: Any, names: tuple[str, ...]) -> int:
    """Read these of every result, as far as this version has them; the number of results."""
    return sum(1 for result in results if [getattr(result, name, None) for name in names])


def timed(call: Callable[[], Any]) -> Callable[[], list[float]]:
    """Milliseconds of this process for each of three calls: other processes take none of them."""

    def once() -> float:
        started = time.process_time()
        call()
        return 1e3 * (time.process_time() - started)

    return lambda: [once() for _ in range(3)]


def first_frame_ms(file: Path, shown: Path) -> list[float]:
    """Milliseconds of a processor from the start of a new Python, which keeps bytecode, to its first result."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", FIRST, file, shown], env=environment, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return [1e3 * (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)]


def main() -> None:
    """Say where the sources lie and which calls there are, then make those that are asked for."""
    version, every, frames = json.loads(sys.argv[1])
    sys.path[0] = f"{version}/benchmarks"
    calls = {"D": timed(runpy.run_path(f"{version}/benchmarks/report.py")["dct_pair"]((240, 320)))}
    for folder, shown, file in frames:
        presses, image = gelform.read_presses(folder), np.load(shown)
        in_order = sorted(presses.presses, key=lambda press: press.name)
        if not Path(file).is_file():
            gelform.calibrate(replace(presses, presses=tuple(in_order[::every]))).save(
                made := f"{file}.{os.getpid()}.npz"
            )
            os.replace(made, file)
        calibration = gelform.load_calibration(file)
        own = whole_frames(calibration, image, Images(press.image for press in in_order[:IMAGES]))
        if "mini" in Path(folder).name:
            starter = gelform.calibration_from_background(presses.background, "gelsight-mini")
            own["everything by a starter"] = timed(
                partial(
                    lambda r, image: read([r.from_image(image)], EVERYTHING),
                    gelform.Reconstructor(starter),
                    image,
                )
            )
        own["first of a process"] = partial(first_frame_ms, file, shown)
        try:
            parts = runpy.run_path(f"{version}/benchmarks/speed.py")["stages"](calibration, image)
            own |= {
                f"stage: {part}": timed(call) for part, call in parts.items() if "whole frame" not in part
            }
        except Exception as problem:  # the table of an old version may not fit its own code
            print(f"{version}: no stages, {problem!r}", file=sys.stderr)
        calls |= {f"{Path(folder).name}, {name}": call for name, call in own.items()}
    print(json.dumps([gelform.__file__, *calls]), flush=True)
    for line in sys.stdin:
        print(json.dumps(calls[line.rstrip("\n")]()), flush=True)


if __name__ == "__main__":
    main()
