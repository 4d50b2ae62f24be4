"""Parts of strangers.py: presses that calibration rejects or takes in wrongly, and backgrounds of another make."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

import gelform
from gelform.calibration.starters import load_starter
from gelform.image.agreement import READINGS, USUAL_ORDERS
from presses import DATA, unlabeled
from real_frames.contacts import with_noise
from real_frames.faults import lying
from real_frames.sets import MINI, Run
from starters.make import unit_of
from strangers.rows import Row, row, shown
from strangers.units import (
    BALLS,
    DIGIT,
    HOMEMADE,
    MAKES,
    background,
    clips,
    own,
    said_of,
    spread_over,
    starter_without,
    wedge_rests,
)

# Presses of a mixed set: of its ball, of the gel at rest, and of a cube's edge on a Mini
TRUE, AT_REST, ALIEN = 10, 2, 2


def presses(run: Run) -> dict[str, Row]:
    """Presses of a ball that calibration rejects; frames at rest and of another set, mixed in, that it accepts."""
    rows: dict[str, Row] = {}
    for name in (*BALLS, *HOMEMADE):
        report = own(run, name).report
        assert report is not None
        rows[f"{name}, all"] = row(yes=[not one.accepted for one in report.presses])
    for name in run.some(BALLS):
        said = run.kept(f"{name}, mixed", lambda name=name: _mixed(run, name))  # type: ignore[misc]
        rows[f"{name}, mixed"] = row(no=said[1], yes=said[0])
    return shown("press", rows)


def _mixed(run: Run, name: str) -> tuple[list[bool], list[bool]]:
    """Which true presses are rejected, and which others accepted; all are rejected where the set is refused."""
    known, rng = unlabeled(run.presses(name)), np.random.default_rng(0)
    true = spread_over(known.presses, TRUE)
    calibration = run.calibration(name)
    rest = [with_noise(calibration, rng) for _ in range(AT_REST)]
    height, width = known.background.shape[:2]
    paths = spread_over(sorted((DATA / "mini-edge" / "images").glob("*.png")), ALIEN)
    edges = [cv2.resize(gelform.read_image(path), (width, height)) for path in paths]
    others = [replace(true[k], name=f"other-{k}", image=image) for k, image in enumerate((*rest, *edges))]
    mixed = replace(known, presses=(*true, *others))
    try:
        report = gelform.calibrate(mixed).report
    except gelform.errors.CalibrationError:
        return [True] * len(true), [False] * len(others)
    assert report is not None
    accepted = {one.name: one.accepted for one in report.presses}
    return [not accepted[one.name] for one in true], [accepted[one.name] for one in others]


def light(run: Run) -> dict[str, Row]:
    """Backgrounds of the right make that `check_light` refuses, and of another make or turned that pass without a word."""
    rests = {name: [background(run, name)] for name in (*MAKES, *BALLS, *HOMEMADE)}
    for one in clips(run):
        rests.setdefault(one.crop, []).append(one.background)
    rests["force-wedge"] = list(run.some(list(wedge_rests().values())))
    rows: dict[str, Row] = {}
    for name, images in rests.items():
        own_make = MINI if name.startswith("mini-octopi") else MAKES.get(name)
        for make in (MINI, DIGIT):
            starter = starter_without(run, name) if make == MAKES.get(name) else load_starter(make)
            height, width = starter.calibration.image_shape
            said = []
            for image in images:
                fitted = np.clip(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), 0, 255)
                readings = (
                    [one for one in READINGS if not one.transposed and one.order in USUAL_ORDERS]
                    if make == own_make
                    else [None]
                )
                for reading in readings:
                    given = fitted if reading is None else lying(fitted, reading)
                    why, found = said_of(unit_of, starter, given)
                    plain = reading == READINGS[0]
                    said.append((plain, why is None and "starter_light" not in found, why, found))
            figures = [found["starter_light"] for *_, found in said if "starter_light" in found]
            right = [why is not None for plain, _, why, _ in said if plain]
            wrong = [silent for plain, silent, *_ in said if not plain]
            what = "turned, mirrored or BGR" if make == own_make else f"as a {make}"
            rows[f"{name}, {what}"] = row(no=right, yes=wrong, figures=figures)
    return shown("background's light", rows)
