"""Parts of real_frames.py: frames of another exposure, turned, mirrored and BGR ones, and torn ones."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

import gelform
from gelform.image.agreement import READINGS, Orientation, orientation_from_image
from gelform.image.health import FrameHealth
from presses import DATA
from real_frames.contacts import OBJECTS, UNTOUCHED
from real_frames.sets import MINIS, Run, background_of, percent
from report import table

FACTORS = (0.95, 1.05)
DEEP = 0.3  # of the peak: pixels of the press itself
SHARES = {"median": 0.5, "90 %": 0.9, "max": 1.0}
RIDGE, RIDGE_REST, RIDGE_TOUCHED = "cheese_tube_3", range(8, 27), range(27, 189)  # a clip, and its frames


def exposure(run: Run) -> dict[str, Any]:
    """Change of depth over a press's peak, percent, where the image alone is 5 % darker or brighter.

    `moved` is the median over the pixels deeper than 0.3 of the peak, `largest` that of the worst pixel of the frame.
    """
    figures: dict[str, Any] = {}
    for name in run.sets:
        reconstruct = gelform.Reconstructor(run.calibration(name))
        moved = [_moved(reconstruct, press.image) for press in run.some(run.presses(name).presses)]
        both = zip(("moved", "largest"), np.array(moved).reshape(-1, 2).T)
        found = {
            f"{what}, {key}": float(np.quantile(of, q)) for what, of in both for key, q in SHARES.items()
        }
        figures[name] = {"frames": len(FACTORS) * len(moved), **found}
    header = ["image x 0.95, 1.05", *next(iter(figures.values()))]
    print("\n" + table(header, [[k, *v.values()] for k, v in figures.items()]), flush=True)
    return figures


def _moved(reconstruct: gelform.Reconstructor, image: np.ndarray) -> list[tuple[float, float]]:
    """For each factor, percent of the peak: the median change of depth in the contact, and the largest in the frame."""
    depth, changes = reconstruct.from_image(image).depth_mm, []
    peak = float(depth.max())
    for factor in FACTORS:
        other = np.clip(np.rint(factor * image.astype(np.float64)), 0, 255).astype(np.uint8)
        off = 100 / peak * np.abs(reconstruct.from_image(other).depth_mm - depth)
        changes.append((float(np.median(off[depth > DEEP * peak])), float(off.max())))
    return changes


def orientation(run: Run) -> dict[str, Any]:
    """Presses in all 48 readings against their set's background: named rightly, wrongly, or not at all."""
    figures: dict[str, Any] = {}
    for name in run.sets:
        presses, found = run.presses(name), []
        for press in run.some(presses.presses):
            found += [
                (one, orientation_from_image(lying(press.image, one), presses.background)) for one in READINGS
            ]
        right = [named == one for one, named in found]
        wrong = [named not in (one, None) for one, named in found]
        figures[name] = {"frames": len(found), "rightly, %": percent(right), "wrongly": sum(wrong)}
    print(
        "\n"
        + table(
            ["48 readings", *next(iter(figures.values()))], [[k, *v.values()] for k, v in figures.items()]
        )
    )
    return figures


def lying(image: np.ndarray, reading: Orientation) -> np.ndarray:
    """The image that a reading turns into the given one."""
    other = image[:: -1 if "y" in reading.flip else 1, :: -1 if "x" in reading.flip else 1]
    other = other.transpose(1, 0, 2) if reading.transposed else other
    return np.ascontiguousarray(other[..., ["RGB".index(one) for one in reading.order]])


def tears(run: Run) -> dict[str, Any]:
    """Frames called torn: sound ones of every set and of a ridge along the rows, and ones with an older lower half."""
    figures: dict[str, Any] = {}
    frames = [one.image for one in gelform.Video(DATA / "slip" / "clips" / f"{RIDGE}.avi").frames()]
    rest = np.median([frames[k] for k in RIDGE_REST], axis=0).astype(np.float32)
    figures[f"sound: {RIDGE}, in contact"] = torn(rest, run.some([frames[k] for k in RIDGE_TOUCHED]))
    for name in run.sets:
        presses = run.presses(name)
        images = run.some([press.image for press in presses.presses])
        figures[f"sound: {name}"] = torn(presses.background, images)
    for name in MINIS:
        folder = DATA / name
        paths = sorted((folder / "images").glob("*.png")) or [folder / f"{one}.png" for one in OBJECTS]
        figures[f"sound: {name}"] = torn(
            background_of(name), run.some([gelform.read_image(p) for p in paths])
        )
    frames = [one.image for one in gelform.Video(DATA / "mini-markers-video" / "mini_example.avi").frames()]
    rest = np.median([frames[k] for k in UNTOUCHED], axis=0).astype(np.float32)
    figures["sound: mini-markers-video"] = torn(rest, run.some(frames))
    if "mini-ball" in run.sets:
        halves = older_halves(run)
        figures["torn: mini-ball, older lower half"] = torn(run.presses("mini-ball").background, halves)
    rows = [[name, *row.values()] for name, row in figures.items()]
    print("\n" + table(["frames", "number", "called torn", "%"], rows), flush=True)
    return figures


def older_halves(run: Run) -> Sequence[np.ndarray]:
    """Frames of mini-ball with the lower half of the press before, where the seam cuts the ball's contact in either."""
    presses, made = run.presses("mini-ball").presses, []
    middle = presses[0].image.shape[0] // 2
    for older, newer in pairwise(presses):
        if any(abs(one.label[1] - middle) < one.label[2] for one in (older, newer)):
            made.append(np.vstack([newer.image[:middle], older.image[middle:]]))
    return run.some(made)


def torn(background: np.ndarray, images: Sequence[np.ndarray]) -> dict[str, float]:
    """The number of frames, and of those called torn."""
    health = FrameHealth(np.asarray(background, dtype=np.float32))
    called = [any(one.name == "torn" for one in health(image).findings) for image in images]
    return {"frames": len(called), "torn": sum(called), "percent": percent(called)}
