"""Data sets: frames per second, kills, corrupt inputs, a million entries, lossy video.

    python benchmarks/batch.py                    # all, into results/batch.json: about 40 minutes on 2 cores
    python benchmarks/batch.py rates              # one part; --help names them all
    python benchmarks/batch.py --quick            # small sizes, writes nothing: about 4 minutes

Without ray its rows are left out, with a message. All files are in a temporary folder (TMPDIR). The frames are those of a
simulated sensor: a few different ones under many names, so that making them takes no longer than reading them.
"""

from __future__ import annotations

import os
import resource
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from batch.faults import corrupt, kills, lossy
from batch.rates import DIFFERENT, make_input, rates
from gelform.batch.inputs import listing_of, plan_of
from gelform.batch.records import COLUMNS, PartRecord, write_record
from gelform.batch.run import BatchSummary, _not_done
from report import command_line, parts_asked, recorded, write


def scan(folder: Path, quick: bool) -> dict[str, Any]:
    """Seconds to list, plan and check a finished output of many frames; inputs and outputs are empty files."""
    entries = 20_000 if quick else 1_000_000
    source, output = folder / "many", folder / "many-out"
    for k in range(entries):
        path = source / f"{k // 10_000:04d}" / f"{k:08d}.png"
        if k % 10_000 == 0:
            path.parent.mkdir(parents=True)
            (output / "frames" / path.parent.name).mkdir(parents=True)
        os.close(os.open(path, os.O_CREAT))
    for part in plan_of(listing_of(source), 256):
        rows = [_row(part.film.name, name, part.start + k) for k, name in enumerate(part.names)]
        for row in rows:
            os.close(os.open(output / row["output"], os.O_CREAT))
        write_record(output, part.number, PartRecord(part.input_digest(), tuple(rows)))
    before_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    begin = time.perf_counter()
    listing = listing_of(source)
    plan, _ = plan_of(listing, 256), listing.digest
    listed_s = time.perf_counter() - begin
    assert not list(_not_done(output, plan, BatchSummary(), False))
    seconds = time.perf_counter() - begin
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    found = {"entries": entries, "listing_s": listed_s, "resume_scan_s": seconds, "reach_s": 60}
    return found | {"peak_mb": peak_mb, "peak_mb_before": before_mb, "reach_mb": 1000}


def _row(sequence: str, name: str, index: int) -> dict[str, Any]:
    """The row of a finished frame; its output is empty here."""
    figures = {"deepest_mm": 0.123456789, "contact_mm2": 12.3456789, "volume_mm3": 1.23456789, "contacts": 1}
    where = {"sequence": sequence, "frame": name, "index": index, "output": f"frames/{sequence}/{name}.npz"}
    return {**dict.fromkeys(COLUMNS, ""), **where, **figures, "bytes": 0, "sha256": "0" * 64}


def with_input(
    measure: Callable[[Path, int], dict[str, Any]], frames: int, rounds: int, quick: bool
) -> Callable[[Path], dict[str, Any]]:
    """A measurement that first needs some frames in a folder."""

    def measured(folder: Path) -> dict[str, Any]:
        make_input(folder, max(40, frames // 5) if quick else frames)
        return measure(folder, 2 if quick else rounds)

    return measured


def parts(quick: bool) -> dict[str, Callable[[Path], dict[str, Any]]]:
    """Name -> function that measures in a temporary folder."""
    return {
        "rates": lambda folder: rates(folder, quick),
        "scan": lambda folder: scan(folder, quick),
        "kills": with_input(kills, 400, 20, quick),
        "kills_ray": with_input(partial(kills, engine="ray"), 400, 20, quick),
        "corrupt": with_input(corrupt, 2000, 1, quick),
        "lossy": with_input(lossy, DIFFERENT, 1, False),
    }


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def main() -> None:
    """Measure and print; write unless in quick mode."""
    command = command_line(__doc__)
    command.add_argument("--quick", action="store_true")
    arguments = parts_asked(command, parts(True))
    figures = recorded("batch")
    for name in arguments.parts:
        begin = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            figures[name] = parts(arguments.quick)[name](Path(folder))
        figures[name]["took_s"] = round(time.perf_counter() - begin)
        print(f"\n{name}")
        for row in figures[name].get("rows", [figures[name]]):
            print("  " + ", ".join(f"{key} {_text(value)}" for key, value in row.items()), flush=True)
        if not arguments.quick:
            write("batch", figures)


if __name__ == "__main__":
    main()
