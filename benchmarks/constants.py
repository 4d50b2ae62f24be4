"""What each chosen number does: multiplied and divided by 1.2, one at a time, on fixed real frames, films and presses.

    python benchmarks/constants.py image depth     # tries those rooms' numbers; keeps each row in results/constants.json
    python benchmarks/constants.py --only finder   # those whose path or name matches
    python benchmarks/constants.py --parts frames light --jobs 2
    python benchmarks/constants.py --page          # writes docs/numbers.md from the code and the recorded rows

Each trial is a process of its own, which imports gelform with one number of its source changed; so what follows from the
number changes with it. A number in C is changed in a library compiled for the trial. Each number is tried on the parts
(constants/figures.py) that execute a line with it, one in C on all: first on the quick parts, then, until one changes, on
those of its room. A number that does nothing times 1.2 is tried divided by 1.2, too. "nothing" means that no figure changes
by a thousandth.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import pickle
import re
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from types import FrameType
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2  # noqa: F401  # each child would load these again
import scipy.fft
import scipy.linalg
import scipy.ndimage
import scipy.optimize
import scipy.sparse.linalg
import scipy.spatial  # noqa: F401

from constants.chosen import (
    PACKAGE,
    ROOT,
    Changed,
    Number,
    all_numbers,
    changed_c,
    hash_of_sources,
    is_reached,
)
from constants.figures import PARTS, ROOMS, Figures, figures_of, given, parts_of
from constants.page import write_page
from report import RESULTS, command_line, parts_asked

FACTOR, CHANGED = 1.2, 1e-3
RECORD = RESULTS / "constants.json"
_SHARED: dict[str, bytes] = {}
_BEFORE: dict[str, Any] = {}
OFTEN = 500  # calls of a function after which a trace of lines leaves it alone


def _child(number: Number | None, factor: float, work: Callable[..., Any], given: Any, out: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        if number is not None and number.in_c:
            _use_changed_library(number, factor, Path(folder))
        elif number is not None:
            sys.meta_path.insert(0, Changed(number, factor))
        Path(out).write_bytes(pickle.dumps(work(*given)))


def _use_changed_library(number: Number, factor: float, folder: Path) -> None:
    """Compile the kernels with one number changed, and let gelform load them."""
    sys.path.insert(0, str(ROOT))
    import hatch_build

    from gelform._native import instruction_set, kernel

    native, own = shutil.copytree(ROOT / "native", folder / "native"), kernel._FOLDER
    (folder / number.path).write_text(changed_c(number, factor), encoding="utf-8")
    made = hatch_build.compile_kernels(folder, native, [instruction_set()])
    for library in set(own.glob("kernels_base*")) - {own / one.name for one in made}:
        (folder / library.name).symlink_to(library)
    kernel._FOLDER = folder
    kernel.library.cache_clear()


def in_child(work: Callable[..., Any], *given: Any, number: Number | None = None, factor: float = 1.0) -> Any:
    """What a function gives in a fresh process, which imports gelform itself."""
    with tempfile.NamedTemporaryFile() as file:
        child = multiprocessing.get_context("fork").Process(
            target=_child, args=(number, factor, work, given, file.name)
        )
        child.start()
        child.join()
        content = Path(file.name).read_bytes()
    return pickle.loads(content) if content else {"part error": "crash"}


def traced(part: str, shared: dict[str, bytes]) -> tuple[Figures, set[tuple[str, int]]]:
    """The figures of a part, and the lines of gelform in functions that it executes."""
    root, lines, calls = f"{PACKAGE}{os.sep}", set(), Counter[Any]()

    def in_function(frame: FrameType, event: str, _: Any) -> Any:
        lines.add((frame.f_code.co_filename[len(root) :], frame.f_lineno))
        return in_function

    def called(frame: FrameType, event: str, _: Any) -> Any:
        code = frame.f_code
        calls[code] += 1
        if code.co_filename.startswith(root) and code.co_name != "<module>" and calls[code] < OFTEN:
            return in_function(frame, event, _)
        return None

    sys.settrace(called)
    try:
        return figures_of(part, shared), lines
    finally:
        sys.settrace(None)


def change(before: Figures, after: Figures) -> str:
    """What changed, in words: the largest of each kind of figure."""
    changes: dict[str, float] = {}
    said = [str(value) for key, value in after.items() if key.endswith("error") and before.get(key) != value]
    if said:
        return said[0]
    for key, old in before.items():
        new, kind = after.get(key), key.split()[-1]
        if isinstance(old, str) or new is None or old is None:
            changes[kind] = changes.get(kind, 0) + (new != old)
        elif isinstance(old, (int, float)):
            rest = (new - old) if isinstance(old, int) else (new - old) / max(abs(old), 1e-3)
            if abs(rest) > max(abs(changes.get(kind, 0)), CHANGED):
                changes[kind] = rest
    for kind, size in changes.items():
        if size:
            counts = any(
                key.endswith(f" {kind}") and isinstance(one, (int, str)) for key, one in before.items()
            )
            said.append(f"{kind} {size:+.0f}" if counts else f"{kind} {100 * size:+.1f} %")
    return ", ".join(said) or "nothing"


def undisturbed(parts: Iterable[str], cache: Path | None) -> tuple[dict[str, bytes], dict[str, Any]]:
    """What all trials share; and the figures of each part, and the lines that it executes."""
    kept = pickle.loads(cache.read_bytes()) if cache and cache.is_file() else {}
    source = hash_of_sources()
    if kept.get("source") != source:
        kept = {"source": source, "shared": in_child(given), "before": {}}
    for part in parts:
        if part not in kept["before"]:
            kept["before"][part] = in_child(traced, part, kept["shared"])
            print(f"{part}: {len(kept['before'][part][0])} figures", flush=True)
    if cache:
        cache.write_bytes(pickle.dumps(kept))
    return kept["shared"], kept["before"]


def effect(number: Number, part: str) -> str:
    """What a factor does to a part; where it does nothing, its inverse."""
    for factor in (FACTOR, 1 / FACTOR):
        found = change(_BEFORE[part][0], in_child(figures_of, part, _SHARED, number=number, factor=factor))
        if found != "nothing":
            return found if factor > 1 else f"divided: {found}"
    return "nothing"


def row_of(number: Number, asked: Iterable[str], known: dict[str, str | None]) -> dict[str, str | None]:
    """What a number does in each part; None of a part that does not reach it."""
    row = dict(known)
    for part in PARTS:
        reached = [said for said in row.values() if said is not None]
        if part not in parts_of(number.room, bool(reached)) or (set(reached) - {"nothing"} and part in ROOMS):
            continue
        if part in asked and part not in known:
            is_run = number.in_c or is_reached(number, _BEFORE[part][1])
            row[part] = effect(number, part) if is_run else None
    return row


def main() -> None:
    """Try the numbers that were asked for; record and print their rows."""
    command = command_line(__doc__)
    command.add_argument("--only", default="", help="those whose path or name matches")
    command.add_argument("--parts", dest="by", nargs="+", choices=list(PARTS), default=list(PARTS))
    command.add_argument("--again", action="store_true", help="those that have a row, too")
    command.add_argument("--cache", type=Path, help="keep there what all trials share")
    command.add_argument("--jobs", type=int, default=1, help="trials at a time")
    command.add_argument("--page", action="store_true", help="write the page; try nothing")
    numbers = all_numbers()
    asked = parts_asked(command, sorted({number.room for number in numbers}))
    rows = json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.is_file() else {}
    if asked.page:
        write_page(numbers, rows)
        return
    global _SHARED, _BEFORE
    _SHARED, _BEFORE = undisturbed(asked.by, asked.cache)
    with ProcessPoolExecutor(asked.jobs, multiprocessing.get_context("fork")) as pool:
        running = {}
        for number in numbers:
            row = rows.get(number.key, {})
            known = row["parts"] if row.get("value") == number.value and not asked.again else {}
            if number.room in asked.parts and re.search(asked.only, f"{number.path} {number.name}"):
                running[pool.submit(row_of, number, asked.by, known)] = number
        for done in as_completed(running):
            number = running[done]
            rows[number.key] = {"value": number.value, "parts": done.result()}
            print(f"| {number.key} | {number.value if number.name else ''} | {done.result()}", flush=True)
            text = json.dumps(rows, indent=1, ensure_ascii=False, sort_keys=True)
            RECORD.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
