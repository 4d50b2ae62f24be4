"""docs/numbers.md: every chosen number of the estimators, from the code and the recorded trials."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from itertools import groupby
from typing import Any

from constants.chosen import ROOT, Number
from constants.figures import parts_of

PAGE = ROOT / "docs" / "numbers.md"
UNITS = {
    "PX": "px", "MM": "mm", "MM2": "mm²", "S": "s", "HZ": "Hz", "DEG": "°", "RAD": "rad", "BYTES": "bytes", "MB": "MB",
    "SIGMAS": "σ", "SIGMA": "of its quantity", "SHARE": "share", "FRACTION": "share", "FRAMES": "frames",
    "SAMPLES": "samples", "PIXELS": "pixels",
}  # fmt: skip
SAID = re.compile(
    r"(px|mm/mm|mm²|mm\^2|mm|s|gray levels|bytes|radii|nats|N/mm\^3|standard deviations|frames|presses|pixels|samples|"
    r"fraction|share|0-1)\b"
)
INTRODUCTION = """# Chosen numbers

Each number of the estimators that somebody chose, in its room: what estimates depth, slopes, circles, light, motion and
force, without commands, pages, exporters and the simulator. Counts up to 4, powers of two and ten, halves, and indices are
left out. A name in capitals is a constant; other rows are lines of code with a number in them.

`python benchmarks/constants.py --page` writes this page from the code. "x 1.2" is what a multiplication by 1.2 changes in
the parts of that script that execute the line, as recorded in `benchmarks/results/constants.json`: force, changed light,
dots, frames of five sets; where none of these changes, motion for numbers of that room, streams with faults for those of
sensors, circles and presses for those of calibration, and all for numbers that none of the four reaches. "nothing" also
holds for a division. "not reached" is a line that no part executes.

| room | constants | lines with other numbers | tried | do nothing |
|---|---|---|---|---|
"""


def unit_of(number: Number) -> str:
    """The unit, from the end of the name or the beginning of the comment."""
    for name in number.name.split(", "):
        for end in (name.split("_")[-1], "_".join(name.split("_")[-2:])):
            if end in UNITS:
                return UNITS[end]
    found = SAID.match(re.sub(r"^(of|in) ", "", number.says))
    return found.group(1) if found else ""


def outcome(number: Number, rows: Mapping[str, Any]) -> str:
    """What times 1.2 does, as recorded for this value."""
    row = rows.get(number.key)
    if row is None or row["value"] != number.value:
        return "not tried"
    reached = {part: said for part, said in row["parts"].items() if said is not None}
    changed = [f"{part}: {said}" for part, said in reached.items() if said != "nothing"]
    if changed:
        return "; ".join(changed)
    if not set(row["parts"]) >= set(parts_of(number.room, bool(reached))):
        return "not tried on all"
    return "nothing" if reached else "not reached"


def cell(text: str) -> str:
    """Text inside a table."""
    return re.sub(r"\s+", " ", text).replace("|", "\\|")


def code(text: str, most: int = 90) -> str:
    """Code inside a table, cut where it is long."""
    short = cell(text)
    short = short if len(short) <= most else short[: most - 1] + "…"
    return f"``{short}``" if "`" in short else f"`{short}`"


def page(numbers: Iterable[Number], rows: Mapping[str, Any]) -> str:
    """The whole page."""
    rooms = {room: list(of) for room, of in groupby(sorted(numbers, key=_order), key=lambda one: one.room)}
    lines, tables = [], []
    for room, of in rooms.items():
        said = [outcome(one, rows) for one in of]
        named = sum(bool(one.name) for one in of)
        tried = sum(not one.startswith("not tried") for one in said)
        lines.append(f"| {room} | {named} | {len(of) - named} | {tried} | {said.count('nothing')} |")
        tables += [
            "",
            f"## {room}",
            "",
            "| file | number | unit | value | origin | x 1.2 |",
            "|---|---|---|---|---|---|",
        ]
        for one, found in zip(of, said):
            name, value = (f"`{one.name}`", code(one.value)) if one.name else ("", code(one.value))
            file = one.path.removeprefix("native/").removeprefix(f"{room}/")
            tables.append(
                f"| {file} | {name} | {unit_of(one)} | {value} | {cell(one.says)} | {cell(found)} |"
            )
    return INTRODUCTION + "\n".join([*lines, *tables]) + "\n"


def _order(number: Number) -> tuple[str, str, bool]:
    return number.room, number.path, not number.name


def write_page(numbers: Iterable[Number], rows: Mapping[str, Any]) -> None:
    """Write the page."""
    PAGE.write_text(page(numbers, rows), encoding="utf-8")
