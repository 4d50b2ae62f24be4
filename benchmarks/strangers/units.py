"""Units of real sensors: the gel at rest, frames with a touch, and a starter that the unit had no part in."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import gelform
from force import pressed_names, wedge_of
from gelform.calibration.starters import Starter, load_starter, starter_from_calibration
from presses import DATA
from real_frames.contacts import OBJECTS
from real_frames.sets import MINI, SETS, Run, background_of
from starters.make import unit_of

DIGIT = "digit"
BALLS = (*SETS, "digit-c")
HOMEMADE = ("homemade-even/a", "homemade-even/b", "homemade-hd")
MAKES = {
    **dict.fromkeys(("mini-ball", "mini-d", "mini-edge", "mini-objects", "mini-sphere-force"), MINI),
    **dict.fromkeys(("digit-ball", "digit-c"), DIGIT),
}
# The starters' own units, and the other unit of the make that makes a starter for each
OTHER_UNIT = {"mini-ball": "mini-d", "mini-d": "mini-ball", "digit-ball": "digit-c"}
BEGINNING, SECOND = 3, 25  # frames of a clip: those of its background, and those that surely are at rest
DARK_BORDER = 92  # mean gray level; the clips with the gel's rim in sight are darker
HARD_NAMES = (
    "baseball", "lanyard_card", "tsa_lock", "rice", "peg", "pen_", "brush", "scissor", "strainer", "controller",
    "remote", "wires", "knife", "book",
)  # fmt: skip
WEDGE_N = 2.0
TOUCHES = 20  # frames with a touch of a set of balls


# Why something was refused, or None; and its findings, by name with their figures
Said = tuple[str | None, dict[str, float]]


@dataclass(frozen=True)
class Clip:
    """One clip of mini-octopi, which begins at rest."""

    name: str
    frames: tuple[np.ndarray, ...]

    @property
    def background(self) -> np.ndarray:
        """Mean of the first frames."""
        return np.mean(self.frames[:BEGINNING], axis=0).astype(np.float32)

    @property
    def crop(self) -> str:
        """`wide` with the gel's rim in sight, or `narrow`."""
        return "mini-octopi, wide" if self.background.mean() < DARK_BORDER else "mini-octopi, narrow"

    @property
    def touched(self) -> np.ndarray:
        """The frame that differs most from the background."""
        background = self.background
        return max(self.frames, key=lambda one: float(np.abs(one - background).mean()))

    @property
    def is_hard(self) -> bool:
        """Whether its name is that of a hard thing."""
        return any(name in self.name for name in HARD_NAMES)


@cache
def clip_paths() -> tuple[Path, ...]:
    """The files of mini-octopi."""
    return tuple(sorted((DATA / "mini-octopi").glob("*.mov")))


@cache
def clip(path: Path) -> Clip:
    """One of them, decoded."""
    return Clip(path.stem, tuple(one.image for one in gelform.Video(path).frames()))


def clips(run: Run) -> list[Clip]:
    """All clips, or every sixth."""
    return [clip(path) for path in run.some(clip_paths())]


def starter_without(run: Run, name: str) -> Starter:
    """The starter of a unit's make; if the unit is one of its own, one that is made of another unit."""
    shipped = load_starter(MAKES.get(name, MINI))
    if name not in OTHER_UNIT:
        return shipped
    other = OTHER_UNIT[name]
    stated = {"spread": shipped.spread, "color_variance": shipped.color_variance}
    return starter_from_calibration(run.calibration(other), shipped.sensor, units=(other,), **stated)


def pitch_of(name: str) -> float | None:
    """Width of a pixel of a set of presses, mm; None: the make's."""
    return gelform.read_presses(DATA / name).mm_per_px if name in BALLS else None


def own(run: Run, name: str) -> gelform.Calibration:
    """A unit's own calibration, or its starter's where it has no presses."""
    if name == "force-wedge":
        return run.kept("force-wedge, three presses", lambda: wedge_of(few_of_wedge()))
    if name in BALLS or name == "homemade-hd":
        return run.calibration(name)
    if name in HOMEMADE:
        return run.kept(name, lambda: gelform.calibrate(gelform.read_presses(DATA / name)))
    return unit_of(load_starter(MAKES[name]), background_of(name))


def few_of_wedge() -> list[str]:
    """The golf ball's middle frame of each of its three grasps, of those that press: three presses."""
    grasps: dict[str, list[str]] = {}
    for name in pressed_names():
        grasps.setdefault(Path(name).parent.name, []).append(name)
    return [names[len(names) // 2] for names in grasps.values()]


def background(run: Run, name: str) -> np.ndarray:
    """The background image of a set, (H, W, 3), float32."""
    if name in MAKES and name not in BALLS:
        return background_of(name).astype(np.float32)
    return np.asarray(gelform.read_presses(DATA / name).background, dtype=np.float32)


def touches(run: Run, name: str) -> Sequence[np.ndarray]:
    """Frames of a set in which something touches the gel, for a quick run every sixth of them."""
    if name == "mini-objects":
        return run.some([gelform.read_image(DATA / name / f"{one}.png") for one in OBJECTS])
    if name in MAKES and name not in BALLS:
        paths = sorted((DATA / name / "images").glob("*.png"))
        return [gelform.read_image(path) for path in run.some(spread_over(paths, TOUCHES))]
    return [one.image for one in run.some(spread_over(gelform.read_presses(DATA / name).presses, TOUCHES))]


def spread_over(items: Sequence[Any], count: int) -> list[Any]:
    """At most so many of them, evenly spread."""
    return [items[int(k * len(items) / count)] for k in range(count)] if len(items) > count else list(items)


@cache
def wedge_rows() -> tuple[dict[str, str], ...]:
    """Image, object, grasp, frame and force of the frames of force-wedge."""
    with (DATA / "force-wedge" / "loads.csv").open(encoding="utf-8") as file:
        return tuple(csv.DictReader(file))


@cache
def wedge_rests() -> dict[str, np.ndarray]:
    """The image at rest of each grasp of force-wedge."""
    paths = sorted((DATA / "force-wedge" / "images").glob("*/rest.png"))
    return {path.parent.name: gelform.read_image(path).astype(np.float32) for path in paths}


def wedge_pressed(objects: Sequence[str] | None = None) -> list[tuple[str, str]]:
    """Grasp and image of the frames of force-wedge beyond 2 N, of these objects or of all."""
    return [
        (Path(row["image"]).parent.name, row["image"])
        for row in wedge_rows()
        if float(row["force_n"]) > WEDGE_N and (objects is None or row["object"] in objects)
    ]


def said_of(make: Callable[..., Any], *given: Any, **known: Any) -> Said:
    """What is said of what `make` makes: a calibration, or what reconstructs with it."""
    try:
        return None, {one.name: one.figure for one in make(*given, **known).findings}
    except gelform.errors.CalibrationError as problem:
        return str(problem), {}
