"""Where the object moved: errors of poses on real and simulated contacts, how honest, what is named blind, and its time.

    python benchmarks/motion.py                 all parts; writes results/motion.json
    python benchmarks/motion.py edges --quick   one part, fewer pairs; writes nothing
    python benchmarks/motion.py --out DIR       writes DIR/motion.json instead

The baseline is the published objective, written from its paper, on the same slopes (motion/published.py). Clips are judged
by the gel's dots where the object sticks; balls by the circles for scoring; edges by the line between the faces.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from motion.clips import clips
from motion.shapes import balls, edges, simulated, starters
from motion.surfaces import surface
from presses import data_is_missing
from report import command_line, machine, parts_asked, write

PARTS = {
    "clips": clips,
    "balls": balls,
    "starters": starters,
    "edges": edges,
    "simulated": simulated,
    "surface": surface,
}
REAL = ("clips", "balls", "starters", "edges")


def main() -> None:
    """Measure, print and record."""
    command = command_line(__doc__)
    command.add_argument("--quick", action="store_true", help="fewer pairs; write nothing")
    command.add_argument("--out", type=Path, help="folder for motion.json, instead of results/")
    asked = parts_asked(command, PARTS)
    figures: dict[str, Any] = {}
    for name in asked.parts:
        if name in REAL and data_is_missing(name):
            continue
        figures[name] = PARTS[name](asked.quick)
        print(name, json.dumps(figures[name], indent=1, default=float), flush=True)
    if asked.quick:
        return
    if asked.out is not None:
        text = json.dumps({"machine": machine(), **figures}, indent=1, default=float)
        (asked.out / "motion.json").write_text(text + "\n")
    elif set(asked.parts) == set(PARTS):
        write("motion", figures)


if __name__ == "__main__":
    main()
