"""Real frames that are not the ball of the calibration, beside the balls: contacts, edges, light, torn frames.

    python benchmarks/real_frames.py                       # all; writes results/real_frames.json after each part
    python benchmarks/real_frames.py contacts rest --quick # every sixth frame, and nothing is written
    python benchmarks/real_frames.py --pages               # writes the recorded figures into README and docs
    python benchmarks/real_frames.py --sets mini-ball,mini-d --cache /tmp/calibrations exposure

`contacts`, `rest`, `exposure`, `light` and `following` use each set's own calibration on all its presses; `balls` judges
held-out ones.
The data are read from GELFORM_DATA (default ../shared/data); without it only `simulated` runs. A cached calibration is used
again while the sources that calibrations follow from stay the same. Figures of some sets alone are not written.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from presses import data_is_missing
from real_frames.balls import balls
from real_frames.beyond import beyond
from real_frames.contacts import contacts, rest
from real_frames.edges import edges
from real_frames.faces import faces
from real_frames.faults import exposure, orientation, tears
from real_frames.following import following
from real_frames.light import light
from real_frames.page import fill_pages
from real_frames.sets import SETS, Run
from real_frames.simulated import simulated
from report import command_line, parts_asked, recorded, write

PARTS: dict[str, Any] = {
    "contacts": contacts,
    "rest": rest,
    "simulated": simulated,
    "balls": balls,
    "edges": edges,
    "faces": faces,
    "beyond": beyond,
    "exposure": exposure,
    "light": light,
    "following": following,
    "orientation": orientation,
    "tears": tears,
}


def main() -> None:
    """Run the named parts, or all; keep the earlier figures of the others."""
    command = command_line(__doc__)
    command.add_argument("--quick", action="store_true", help="every sixth frame; write nothing")
    command.add_argument("--sets", metavar="SET,...", help=f"of {', '.join(SETS)}; write nothing")
    command.add_argument(
        "--cache", type=Path, metavar="DIR", help="keep the calibrations there for later runs"
    )
    command.add_argument(
        "--pages", action="store_true", help="write the recorded figures into the pages; measure nothing"
    )
    asked = parts_asked(command, PARTS)
    if asked.pages:
        print("changed: " + (", ".join(fill_pages(recorded("real_frames"))) or "no page"))
        return
    sets = tuple(asked.sets.split(",")) if asked.sets else SETS
    if unknown := [name for name in sets if name not in SETS]:
        command.error(f"no set {', '.join(unknown)}: expected {', '.join(SETS)}")
    run, figures = Run(sets, asked.quick, asked.cache), recorded("real_frames")
    for name in asked.parts:
        if name != "simulated" and data_is_missing(name):
            continue
        start = time.process_time()
        figures[name] = PARTS[name](run)
        print(f"\n{name}: {time.process_time() - start:.0f} s of CPU", flush=True)
        if not asked.quick and sets == SETS:
            write("real_frames", figures)


if __name__ == "__main__":
    main()
