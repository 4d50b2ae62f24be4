"""What each chosen number does: multiplied and divided by 1.2, one at a time, on fixed real frames, films and presses.

    python benchmarks/constants.py image depth     # tries those rooms' numbers; keeps each row in results/constants.json
    python benchmarks/constants.py --only finder   # those whose path or name matches
    python benchmarks/constants.py --parts frames light
    python benchmarks/constants.py --page          # writes docs/numbers.md from the code and the recorded rows

Each trial is a process of its own, which imports gelform with one number of its source changed; so what follows from the
number changes with it. Each number is tried on the parts (constants/figures.py) that execute a line with it. A number that
does nothing times 1.2 is tried divided by 1.2, too. "nothing" means that no figure changes by a thousandth.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import pickle
import re
import sys
import tempfile
from collections.abc import Callable, Iterable
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

from constants.chosen import PACKAGE, Changed, Number, all_numbers, is_reached
from constants.figures import PARTS, Figures, figures_of, given
from constants.page import write_page
from report import RESULTS, command_line, parts_asked

FACTOR, CHANGED = 1.2, 1e-3
RECORD = RESULTS / "constants.json"


def _child(number: Number | None, factor: float, work: Callable[..., Any], given: Any, out: str) -> None:
    if number is not None:
        sys.meta_path.insert(0, Changed(number, factor))
    Path(out).write_bytes(pickle.dumps(work(*given)))


def in_child(work: Callable[..., Any], *given: Any, number: Number | None = None, factor: float = 1.0) -> Any:
    """What a function gives in a fresh process, which imports gelform itself."""
    with tempfile.NamedTemporaryFile() as file:
        child = multiprocessing.get_context("fork").Process(
            target=_child, args=(number, factor, work, given, file.name)
        )
        child.start()
        child.join()
        content = Path(file.name).read_bytes()
    return pickle.loads(content) if content else {"part error": "no import"}


def traced(part: str, shared: dict[str, bytes]) -> tuple[Figures, set[tuple[str, int]]]:
    """The figures of a part, and the lines of gelform in functions that it executes."""
    root, lines = f"{PACKAGE}{os.sep}", set()

    def in_function(frame: FrameType, event: str, _: Any) -> Any:
        lines.add((frame.f_code.co_filename[len(root) :], frame.f_lineno))
        return in_function

    def called(frame: FrameType, event: str, _: Any) -> Any:
        code = frame.f_code
        if code.co_filename.startswith(root) and code.co_name != "<module>":
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


def reached_by(
    shared: dict[str, bytes], parts: Iterable[str]
) -> dict[str, tuple[Figures, set[tuple[str, int]]]]:
    """The undisturbed figures of each part, and the lines that it executes."""
    found = {}
    for part in parts:
        found[part] = in_child(traced, part, shared)
        print(f"{part}: {len(found[part][0])} figures", flush=True)
    return found


def tried(
    number: Number, factor: float, parts: Iterable[str], before: dict[str, Any], shared: dict[str, bytes]
) -> str:
    """What a factor does to a number: of each part that changes."""
    said = []
    for part in parts:
        found = change(before[part][0], in_child(figures_of, part, shared, number=number, factor=factor))
        if found != "nothing":
            said.append(f"{part}: {found}")
    return "; ".join(said) or "nothing"


def main() -> None:
    """Try the numbers that were asked for; record and print their rows."""
    command = command_line(__doc__)
    command.add_argument("--only", default="", help="those whose path or name matches")
    command.add_argument("--parts", dest="by", nargs="+", choices=list(PARTS), default=list(PARTS))
    command.add_argument("--again", action="store_true", help="those that have a row, too")
    command.add_argument("--cache", type=Path, help="keep there what all trials share")
    command.add_argument("--page", action="store_true", help="write the page; try nothing")
    numbers = all_numbers()
    asked = parts_asked(command, sorted({number.room for number in numbers}))
    rows = json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.is_file() else {}
    if asked.page:
        write_page(numbers, rows)
        return
    if asked.cache and asked.cache.is_file():
        shared = pickle.loads(asked.cache.read_bytes())
    else:
        shared = in_child(given)
        if asked.cache:
            asked.cache.write_bytes(pickle.dumps(shared))
    before = reached_by(shared, asked.by)
    for number in numbers:
        known = rows.get(number.key, {})
        done = known.get("value") == number.value and set(asked.by) <= set(known.get("parts", []))
        if number.room not in asked.parts or not number.literals or (done and not asked.again):
            continue
        if asked.only and not re.search(asked.only, f"{number.path} {number.name}"):
            continue
        parts = [part for part in asked.by if is_reached(number, before[part][1])]
        row: dict[str, Any] = {"value": number.value, "parts": asked.by, "reached": parts}
        if parts:
            row["more"] = tried(number, FACTOR, parts, before, shared)
            if row["more"] == "nothing":
                row["less"] = tried(number, 1 / FACTOR, parts, before, shared)
        rows[number.key] = row
        print(
            f"| {number.key} | {number.value if number.name else ''} | {parts} | {row.get('more')} | {row.get('less')}",
            flush=True,
        )
        RECORD.write_text(
            json.dumps(rows, indent=1, ensure_ascii=False, sort_keys=True) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main()
