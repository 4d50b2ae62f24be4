"""Part of strangers.py: clips as streams without a background, which begin at rest, or in contact."""

from __future__ import annotations

from pathlib import Path

import gelform
from presses import DATA
from real_frames.sets import MINI, Run
from strangers.rest import TOUCH
from strangers.rows import Row, row, shown
from strangers.units import clip, clip_paths


def streams(run: Run) -> dict[str, Row]:
    """Clips that begin at rest and give no result; clips that begin in contact and give one without a word."""
    rows: dict[str, Row] = {}
    begun = {path: begins(path) for path in run.some(clip_paths())}
    for crop in sorted({clip(path).crop for path in begun}):
        said = [found for path, found in begun.items() if clip(path).crop == crop]
        figures = [found[key] for found in said if found for key in TOUCH if key in found]
        rows[f"{crop}, does not begin"] = row(yes=[found is None for found in said])
        called = [bool(found) and any(key in found for key in TOUCH) for found in said if found is not None]
        rows[f"{crop}, begins and is called touched"] = row(no=called, figures=figures)
    pressed = [begins(path) for path in run.some(sorted((DATA / "slip" / "clips").glob("*.avi")))]
    silent = [found is not None and not any(key in found for key in TOUCH) for found in pressed]
    rows["slip, begins without a finding"] = row(no=silent)
    return shown("stream without a background", rows)


def begins(path: Path) -> dict[str, float] | None:
    """The findings of the first result of a stream of this clip without a background; None: there is none."""
    try:
        with gelform.stream(str(path), sensor=MINI) as stream:
            for result in stream:
                return {one.name: one.figure for one in result.health}
    except gelform.errors.GelformError:
        return None
    return None
