"""Yes/no decisions on units that nobody tuned on: how often each is wrong either way, on every real set.

    python benchmarks/strangers.py                          # all; writes results/strangers.json after each part
    python benchmarks/strangers.py rest touched --quick     # every sixth frame, and nothing is written
    python benchmarks/strangers.py --pages                  # writes the recorded figures into docs/guarantees.md
    python benchmarks/strangers.py --cache /tmp/calibrations streams

A unit is left out of the starter that judges it. `contacts` and `unknown` judge frames that their calibrations have not
seen; today's background in `touched`, and `exposure`, use each set's own calibration on all its presses, as real_frames.py
does. The data are read from GELFORM_DATA (default ../shared/data). A cached calibration is used again while its sources stay
the same.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from presses import data_is_missing
from real_frames.sets import SETS, Run
from report import command_line, parts_asked, recorded, write
from strangers.calibrating import light, presses
from strangers.frames import bands, contacts, exposure, torn, unknown
from strangers.page import decisions, fill
from strangers.rest import moments, rest
from strangers.streams import streams
from strangers.touched import touched

PARTS: dict[str, Any] = {
    "rest": rest,
    "touched": touched,
    "moments": moments,
    "streams": streams,
    "presses": presses,
    "light": light,
    "torn": torn,
    "bands": bands,
    "exposure": exposure,
    "contacts": contacts,
    "unknown": unknown,
}


def main() -> None:
    """Run the named parts, or all; keep the earlier figures of the others."""
    command = command_line(__doc__)
    command.add_argument("--quick", action="store_true", help="every sixth frame; write nothing")
    command.add_argument(
        "--cache", type=Path, metavar="DIR", help="keep the calibrations there for later runs"
    )
    command.add_argument(
        "--pages", action="store_true", help="write the recorded figures into the page; measure nothing"
    )
    asked = parts_asked(command, PARTS)
    run, figures = Run(SETS, asked.quick, asked.cache), recorded("strangers")
    if asked.pages:
        print("changed: " + (", ".join(fill(figures)) or "no page"))
        return
    measured: dict[str, Any] = {}
    for name in asked.parts:
        if data_is_missing(name):
            continue
        start = time.process_time()
        figures[name] = measured[name] = PARTS[name](run)
        print(f"\n{name}: {time.process_time() - start:.0f} s of CPU", flush=True)
        if not asked.quick:
            write("strangers", figures)
    print("\n" + decisions(measured))


if __name__ == "__main__":
    main()
