"""Part of strangers.py: clips as streams without a background, which begin at rest, or in contact."""

from __future__ import annotations

from pathlib import Path

import gelform
from presses import DATA
from real_frames.sets import MINI, Run
from strangers.rest import TOUCH
from strangers.rows import Row, row, shown
from strangers.units import clip, clip_paths

# Clips of slip in which an object touches the gel all through the first two seconds, by eye
IN_CONTACT = (
    "artificial_strawberry_1", "avocado_real_4", "ball_white_thread_1", "ball_white_thread_10", "baseball_1", "cellotape_3",
    "green_rope_1", "lemon_1", "plastic_cup_1", "plug_3D_1", "rubber_hand_1", "rubber_pear_1", "rubber_salmon_fillet_1",
    "screw_driver_blue_gray_1", "tennis_ball_1", "wallet_1",
)  # fmt: skip


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
    pressed = [begins(DATA / "slip" / "clips" / f"{name}.avi") for name in run.some(IN_CONTACT)]
    said = (*TOUCH, "background_unchecked")  # on a gel with dots it cannot be told
    silent = [found is not None and not any(key in found for key in said) for found in pressed]
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
