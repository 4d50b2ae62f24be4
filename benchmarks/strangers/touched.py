"""Parts of strangers.py: backgrounds in which something touches the gel, whole and blended with the gel at rest."""

from __future__ import annotations

from typing import Any

import numpy as np

import gelform
from gelform.calibration.starters import Starter, load_starter
from presses import DATA
from real_frames.sets import MINI, Run
from starters.make import unit_of
from strangers.rest import today
from strangers.rows import Row, row, shown
from strangers.units import (
    BALLS,
    HOMEMADE,
    MAKES,
    Said,
    background,
    clips,
    own,
    pitch_of,
    said_of,
    spread_over,
    starter_without,
    touches,
    wedge_pressed,
    wedge_rests,
)

WEIGHTS = (1.0, 0.5, 0.25)
SAID = ("background_touched", "uneven_background", "background_pattern")
WEDGE_FRAMES = 45
Pair = tuple[np.ndarray, np.ndarray]  # at rest, touched


def touched(run: Run) -> dict[str, Any]:
    """Backgrounds with a touch, accepted without a word: as a starter's, and as today's background of a calibration."""
    rows: dict[str, Row] = {}
    for name in dict.fromkeys((*MAKES, *BALLS, *HOMEMADE)):
        at_rest = background(run, name)
        pairs = [(at_rest, image) for image in touches(run, name)]
        if name in MAKES:
            _of_starter(rows, name, starter_without(run, name), pairs)
        calibration = own(run, name)
        _of_today(rows, name, [(calibration, *pair) for pair in pairs])
    hard = [one for one in clips(run) if one.is_hard]
    for crop in sorted({one.crop for one in hard}):
        chosen = [(one.background, one.touched) for one in hard if one.crop == crop]
        _of_starter(rows, crop, load_starter(MINI), chosen)
        _of_today(rows, crop, [(unit_of(load_starter(MINI), rest), rest, image) for rest, image in chosen])
    wedge, rests = own(run, "force-wedge"), wedge_rests()
    chosen = [
        (rests[grasp], gelform.read_image(DATA / "force-wedge" / image))
        for grasp, image in run.some(spread_over(wedge_pressed(), WEDGE_FRAMES))
    ]
    _of_today(rows, "force-wedge", [(wedge, *pair) for pair in chosen])
    return shown("touched background", rows)


def blend(at_rest: np.ndarray, image: np.ndarray, weight: float) -> np.ndarray:
    """The gel at rest with so much of a touch."""
    return np.asarray(at_rest + weight * (image.astype(np.float32) - at_rest), dtype=np.float32)


def _of_starter(rows: dict[str, Row], name: str, starter: Starter, pairs: list[Pair]) -> None:
    for weight in WEIGHTS:
        given = [blend(*pair, weight) for pair in pairs]
        pitch = pitch_of(name)
        said = [said_of(starter.for_frame, image, mm_per_px=pitch) for image in given]
        rows[f"{name}, starter, {weight:g}"] = _row(said)


def _of_today(rows: dict[str, Row], name: str, given: list[tuple[Any, np.ndarray, np.ndarray]]) -> None:
    for weight in WEIGHTS:
        said = [today(calibration, blend(at_rest, image, weight)) for calibration, at_rest, image in given]
        rows[f"{name}, today, {weight:g}"] = _row(said)


def _row(said: list[Said]) -> Row:
    silent = [why is None and not any(key in found for key in SAID) for why, found in said]
    figures = [found[key] for _, found in said for key in SAID if key in found]
    return row(yes=silent, figures=figures)
