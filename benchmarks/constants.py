"""Which tuned constants matter: each is halved and doubled, and the movement of every figure is compared with its noise.

    python benchmarks/constants.py                    # about an hour; writes results/constants.json
    python benchmarks/constants.py confidence contact # of these rooms or files
    python benchmarks/constants.py --table            # what is in the file, and nothing is measured

Six sets of real presses below GELFORM_DATA, a simulated sensor, and degraded images of it; twelve presses calibrate.
The noise of a figure is its standard deviation over draws of other presses. The sets follow each other until one figure
moves further than its noise, first with the calibrations that are there, then with those made anew. A constant that
no function reads on the way is not exercised. Each run has a process of its own, with the module's text changed.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import tempfile
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import cv2  # noqa: F401  imported here so that the forked processes need not
import numpy as np
import scipy.fft
import scipy.interpolate
import scipy.ndimage
import scipy.optimize
import scipy.sparse.linalg
import scipy.spatial  # noqa: F401

from constants.changed import ChangedModule, Constant, Executed, constants, lines_with
from constants.figures import DEGRADED, DRAWS, Figures, all_sets, calibration_of, figures, make_sets

RESULTS = Path(__file__).parent / "results"
FACTORS = (2.0, 0.5)
LEAST_NOISE = 1e-3  # of a figure's value: draws that agree by chance


def main() -> None:
    """Measure the constants that are named, or all; keep the others' last results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "rooms", nargs="*", help="folders or files below src/gelform, or names of constants; all by default"
    )
    parser.add_argument("--table", action="store_true", help="print the results so far, and measure nothing")
    parser.add_argument(
        "--only", choices=("as calibrated", "anew"), help="leave out the other half of the sets"
    )
    parser.add_argument("--sets", nargs="+", help="of presses, all by default")
    parser.add_argument(
        "--keep", type=Path, help="folder for presses and noise that later runs can use again"
    )
    asked = parser.parse_args()
    if not asked.table:
        rooms = tuple(asked.rooms)
        chosen = [one for one in constants() if not rooms or one.label.startswith(rooms) or one.name in rooms]
        with tempfile.TemporaryDirectory() as temporary:
            folder = asked.keep or Path(temporary)
            folder.mkdir(parents=True, exist_ok=True)
            measure(chosen, folder, asked.sets or in_process(all_sets), asked.only)
    print(results_table())


def measure(chosen: list[Constant], folder: Path, sets: Sequence[str], only: str | None) -> None:
    """Sweep these constants and write each result as it comes."""
    base = prepared(folder, sets, only)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for one, result in zip(chosen, pool.map(lambda one: swept(one, base, folder), chosen)):
            print(one.label, json.dumps(result, default=float), flush=True)
            in_process(partial(record, one.label, result))


def prepared(folder: Path, sets: Sequence[str], only: str | None) -> list[dict[str, Any]]:
    """The unchanged figures of every set, their noise, and what is exercised on the way: measured once into a folder."""
    missing = [name for name in sets if not (folder / name).exists()]
    if missing:
        in_process(partial(make_sets, folder, missing))
    stages = [] if only == "anew" else [(name, False) for name in sets]
    stages += [] if only == "as calibrated" else [(name, True) for name in sets if name != DEGRADED]
    found = []
    for name, anew in stages:
        kept = folder / f"base {name}{' anew' if anew else ''}.json"
        if not kept.exists():
            kept.write_text(json.dumps(_base(folder, name, anew)))
            print(f"base: {name}{', calibrated anew' if anew else ''}", flush=True)
        found.append(json.loads(kept.read_text()))
    return found


def _base(folder: Path, name: str, anew: bool) -> dict[str, Any]:
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(lambda k: in_process(partial(_made, folder, name, k)), range(DRAWS)))
    drawn = [in_process(partial(figures, folder, name, draw)) for draw in range(DRAWS)]
    first, executed = in_process(partial(_traced, folder, name, anew))
    noise = {
        key: max(float(np.std([one[key] for one in drawn], ddof=1)), LEAST_NOISE * abs(value))
        for key, value in first.items()
        if all(key in one for one in drawn)
    }
    return {"stage": [name, anew], "figures": first, "noise": noise, "executed": executed}


def _made(folder: Path, name: str, draw: int) -> None:
    calibration_of(folder, name, draw)


def _traced(folder: Path, name: str, anew: bool) -> tuple[Figures, list[str]]:
    executed = Executed(lines_with(constants()))
    executed.start()
    found = figures(folder, name, 0, anew)
    sys.settrace(None)
    return found, sorted(executed.labels)


def swept(one: Constant, base: list[dict[str, Any]], folder: Path) -> dict[str, Any]:
    """How far a constant's change moves the figures, in units of their noise, and where furthest."""
    stages = [stage for stage in base if one.label in stage["executed"]]
    result: dict[str, Any] = {"value": one.value, "exercised": bool(stages), "tried": [], "moved": 0.0}
    for stage in stages:
        for factor in FACTORS:
            name, anew = stage["stage"]
            value, text = one.changed(factor)
            found = in_process(partial(_changed, one.path, text, folder, name, anew))
            moved, key = movement(found, stage)
            result["tried"].append([f"{name}{', calibrated anew' if anew else ''}", value, moved])
            if moved > result["moved"]:
                result |= {"moved": moved, "figure": key, "set": name, "anew": anew, "changed to": value}
            if result["moved"] > 1:
                return result
    return result


def movement(found: Figures, stage: dict[str, Any]) -> tuple[float, str]:
    """The largest movement in units of noise and its figure; a change that fails moves everything."""
    if "error" in found or found["failed"] != stage["figures"]["failed"]:
        return 99.0, str(found.get("error", "failed"))
    moved = {
        key: min(99.0, abs(found[key] - stage["figures"][key]) / noise)
        if noise
        else 99.0 * (found[key] != before)
        for key, noise in stage["noise"].items()
        if (before := stage["figures"][key]) == before and key in found
    }
    key = max(moved, key=lambda one: moved[one])
    return moved[key], key


def _changed(path: str, text: str, folder: Path, name: str, anew: bool) -> Any:
    sys.meta_path.insert(0, ChangedModule(path, text))
    try:
        return figures(folder, name, 0, anew)
    except Exception as error:  # any failure is a result: this value does not do
        return {"error": f"{type(error).__name__}: {error}"[:200]}


def in_process(call: Callable[[], Any]) -> Any:
    """The result of a call in a forked process, which imports gelform anew."""
    receiver, sender = multiprocessing.Pipe(duplex=False)
    child = multiprocessing.get_context("fork").Process(target=_answer, args=(call, sender))
    child.start()
    sender.close()
    try:
        done, value = receiver.recv()
    finally:
        child.join()
    if not done:
        raise RuntimeError(value)
    return value


def _answer(call: Callable[[], Any], sender: Any) -> None:
    assert "gelform" not in sys.modules
    try:
        sender.send((True, call()))
    except BaseException:
        sender.send((False, traceback.format_exc()))


def record(label: str, result: dict[str, Any]) -> None:
    """Put one constant's result into results/constants.json."""
    from report import recorded, write

    known = {one.label for one in constants()}
    before = recorded("constants").get("constants", {})
    write("constants", {"constants": {k: v for k, v in {**before, label: result}.items() if k in known}})


def results_table() -> str:
    """Constant, value, figure that moved furthest, and how far, as Markdown."""
    found = json.loads((RESULTS / "constants.json").read_text())["constants"]
    rows = [
        f"| {label} | {one['value']} | {one.get('set', '')} {one.get('figure', '')} | {one['moved']:.2g} | "
        f"{'yes' if one['exercised'] else 'no'} |"
        for label, one in sorted(found.items(), key=lambda item: item[1]["moved"])
    ]
    return "\n".join(
        ["| constant | value | figure | moved, in its noise | exercised |", "|---|---|---|---|---|", *rows]
    )


if __name__ == "__main__":
    main()
