"""Interfaces to robots: bags, zenoh, LeRobot; their accuracy and speed.

    python benchmarks/robots.py                                    # writes results/robots.json; about 4 minutes
        --lerobot PYTHON    a Python 3.12 with LeRobot and the camera, as integrations/lerobot_camera_gelform/test.sh makes
    python benchmarks/robots.py --quick                            # fewer frames, writes nothing

Parts without their packages are left out and named; their earlier figures are kept, with their own date.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from collections.abc import Callable
from datetime import datetime, timezone
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from report import recorded, table, write
from robots import bag, zenoh_link

ROOT = Path(__file__).parents[1]
LEROBOT = ROOT / "integrations" / "lerobot_camera_gelform" / "record.py"


def lerobot_rows(figures: dict[str, Any]) -> list[tuple[str, Any, Any]]:
    """(figure, required, measured)."""
    kept, default = figures["lossless"], figures["default"]
    return [
        (f"LeRobot {kept['lerobot']}: depth of 5 s, written and read, um RMS", 1.0, kept["depth_rms_um"]),
        ("the same: frames a second", 30, kept["rate_hz"]),
        ("the same: TimeoutErrors", 0, kept["timeouts"]),
        ("color without loss: largest difference, gray levels", 0, kept["color_worst_level"]),
        ("color without loss: kB a frame", "-", kept["color_kb"]),
        ("depth: kB a frame", "-", kept["depth_kb"]),
        ("color by LeRobot's default: slope error in contact, degrees", "-", default["color_slope_deg"]),
        ("color by LeRobot's default: depth error in contact, um", "-", default["color_depth_um"]),
        ("color by LeRobot's default: kB a frame", "-", default["color_kb"]),
    ]


def main() -> None:
    """Measure the available parts, print the table, write the figures."""
    given = _arguments()
    parts: dict[str, tuple[str | None, Callable[[], Any], Callable[[Any], Any]]] = {
        "bag": (
            _missing("rosbags", "mcap_ros2"),
            lambda: bag.measure(bag.reconstructor(), given.quick),
            bag.rows,
        ),
        "zenoh": (_missing("zenoh", "rosbags"), lambda: zenoh_link.measure(given.quick), zenoh_link.rows),
        "lerobot": (
            None if given.lerobot else "give --lerobot PYTHON",
            lambda: _in(given.lerobot, LEROBOT),
            lerobot_rows,
        ),
    }
    figures = recorded("robots")
    lines: list[Any] = []
    for name, (missing, measure, rows) in parts.items():
        if missing:
            lines.append((f"{name}: not run: {missing}", "", ""))
            continue
        figures[name] = {"date": datetime.now(timezone.utc).date().isoformat(), **measure()}
        lines += rows(figures[name])
    print(table(("figure", "asked", "reached"), lines))
    if not given.quick:
        write("robots", {name: figures[name] for name in parts if name in figures})


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--lerobot", metavar="PYTHON")
    return parser.parse_args()


def _missing(*modules: str) -> str | None:
    absent = [one for one in modules if find_spec(one) is None]
    return f"{', '.join(absent)} is not installed" if absent else None


def _in(python: str, script: Path) -> dict[str, Any]:
    """The JSON in the last line that a script prints in another environment."""
    ran = subprocess.run([python, str(script)], stdout=subprocess.PIPE, text=True, check=True)
    last: dict[str, Any] = json.loads(ran.stdout.splitlines()[-1])
    return last


if __name__ == "__main__":
    main()
