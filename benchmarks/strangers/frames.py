"""Parts of strangers.py, on frames: torn, bands, exposure, hard objects without a contact, imprints that are unknown."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product

import cv2
import numpy as np

import gelform
from gelform.image.health import FrameHealth
from presses import DATA
from real_frames.contacts import with_noise
from real_frames.faults import torn as torn_of
from real_frames.sets import Run
from strangers.rows import Row, row, shown
from strangers.units import (
    BALLS,
    HOMEMADE,
    MAKES,
    background,
    clips,
    own,
    spread_over,
    touches,
    wedge_pressed,
    wedge_rests,
)

SETS_OF_FRAMES = tuple(dict.fromkeys((*MAKES, *BALLS, *HOMEMADE)))
PIECE, SEAM_LEVELS = (
    16,
    2.0,
)  # px along a row, and gray levels: a seam with less of a step is hardly to be seen
EVERY_OF_CLIP = 12
BAND_LEVELS, BAND_PERIODS_PX = (3.0, 10.0, 30.0), (16.0, 60.0)  # amplitude in gray levels
GAINS = (0.9, 1.1)
DARKER_OR_BRIGHTER = ("exposure", "background_ratio")
OFTEN_HARD = ("rigid_strawberry", "purple_ball_hardest")  # hard objects that the wedge was not calibrated on
HARD_FRAMES = 120
# An imprint, of an image of so many rows: relative change of color, lengths in px, least share of the frame
ROWS, FINE, AROUND, OPENED, CLOSED = 240, 1.5, 151, 3, 9
CHANGED, DARK_LEVELS, LEAST_SHARE = 0.06, 8.0, 0.003
UNKNOWN_SHARE, KNOWN_SHARE = 1 / 3, 0.1


def torn(run: Run) -> dict[str, Row]:
    """Sound frames that are called torn, and frames of two moments that are not."""
    rows: dict[str, Row] = {}
    for name in SETS_OF_FRAMES:
        at_rest, images = background(run, name), touches(run, name)
        rows[name] = _torn(at_rest, images)
    for one in clips(run):
        images = one.frames[::EVERY_OF_CLIP]
        rows[one.crop] = _sum(rows.get(one.crop), _torn(one.background, images))
    rests = wedge_rests()
    of_grasp: dict[str, list[np.ndarray]] = {}
    for grasp, image in run.some(spread_over(wedge_pressed(), HARD_FRAMES)):
        of_grasp.setdefault(grasp, []).append(gelform.read_image(DATA / "force-wedge" / image))
    for grasp, images in of_grasp.items():
        rows["force-wedge"] = _sum(rows.get("force-wedge"), _torn(rests[grasp], images))
    return shown("torn", rows)


def bands(run: Run) -> dict[str, Row]:
    """Sound frames that are called banded along rows or columns, and frames with bands that are not.

    The figures are the mean error of the levels after gelform took bands out, over that before.
    """
    rows: dict[str, Row] = {}
    for name in SETS_OF_FRAMES:
        at_rest, images = background(run, name), touches(run, name)
        called = [_bands(at_rest, image, turned)[0] for image in images for turned in (False, True)]
        for levels in BAND_LEVELS:
            missed, left = [], []
            for image, period, multiplies in product((at_rest, *images), BAND_PERIODS_PX, (True, False)):
                wave = np.sin(2 * np.pi * np.arange(len(image)) / period)[:, None, None]
                banded = image * (1 + levels / image.mean() * wave) if multiplies else image + levels * wave
                banded = np.clip(np.rint(banded), 0, 255).astype(np.uint8)
                found, without = _bands(at_rest, banded)
                missed.append(not found)
                if found:
                    left.append(float(np.abs(without - image).mean() / np.abs(banded - image).mean()))
            rows[f"{name}, {levels:g} gray levels"] = row(no=called, yes=missed, figures=left)
    return shown("bands", rows)


def _bands(at_rest: np.ndarray, image: np.ndarray, is_turned: bool = False) -> tuple[bool, np.ndarray]:
    """Whether an image is called banded, and what is left of it."""
    levels = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    faults = FrameHealth(at_rest, is_turned)(levels)
    return any(one.name == "bands" for one in faults.findings), np.asarray(faults.image, dtype=np.float32)


def _torn(at_rest: np.ndarray, images: Sequence[np.ndarray]) -> Row:
    sound, halves = torn_of(at_rest, images), torn_of(at_rest, _halves(images))
    called = [k < sound["torn"] for k in range(int(sound["frames"]))]
    return row(no=called, yes=[k >= halves["torn"] for k in range(int(halves["frames"]))])


def _halves(images: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Frames whose lower half is of the frame before, where the seam shows a step."""
    made = []
    for older, newer in pairwise(images):
        middle = len(newer) // 2
        step = older[middle].astype(np.float32) - newer[middle]
        pieces = step[: len(step) // PIECE * PIECE].reshape(-1, PIECE, 3).mean(axis=1)
        if np.abs(pieces).mean() > SEAM_LEVELS:
            made.append(np.vstack([newer[:middle], older[middle:]]))
    return made


def _sum(one: Row | None, other: Row) -> Row:
    """The rows of two parts of a set as one."""
    if one is None:
        return other
    counts = {
        key: (one[f"{key}, wrong"] + other[f"{key}, wrong"], one[key] + other[key]) for key in ("no", "yes")
    }
    return row(**{key: [k < wrong for k in range(count)] for key, (wrong, count) in counts.items()})


def exposure(run: Run) -> dict[str, Row]:
    """Frames of the background's exposure that are called brighter or darker, and frames of another that are not.

    Frames of the background's own exposure are the gel at rest with the camera's noise; the others are presses,
    times 0.9 and 1.1. A press as it was taken is in neither, because its true exposure is not known.
    """
    rows: dict[str, Row] = {}
    for name in SETS_OF_FRAMES:
        reconstruct = gelform.Reconstructor(own(run, name))
        images, rng = touches(run, name), np.random.default_rng(0)
        plain = [with_noise(reconstruct.calibration, rng) for _ in images]
        called = [_brightness(reconstruct, image) for image in plain]
        other = [gain * image.astype(np.float64) for image in images for gain in GAINS]
        missed = [
            not _brightness(reconstruct, np.clip(np.rint(image), 0, 255).astype(np.uint8)) for image in other
        ]
        rows[name] = row(no=called, yes=missed)
    return shown("exposure", rows)


def _brightness(reconstruct: gelform.Reconstructor, image: np.ndarray) -> bool:
    try:
        health = reconstruct.from_image(image).health
    except gelform.errors.CalibrationError:  # refused: far from the background's light
        return True
    return any(one.name in (*DARKER_OR_BRIGHTER, "exposure_unknown") for one in health)


def contacts(run: Run) -> dict[str, Row]:
    """Hard objects beyond 2 N on the wedge without a contact; those of which `background_pressed` is said."""
    calibration, rests = own(run, "force-wedge"), wedge_rests()
    rows: dict[str, Row] = {}
    for name in OFTEN_HARD:
        chosen = run.some(spread_over(wedge_pressed([name]), HARD_FRAMES))
        known = {grasp: gelform.Reconstructor(calibration, background=rests[grasp]) for grasp, _ in chosen}
        results = [
            known[grasp].from_image(gelform.read_image(DATA / "force-wedge" / image))
            for grasp, image in chosen
        ]
        rows[f"{name}, contact"] = row(yes=[not one.contacts for one in results])
        pressed = [
            {one.name: one.figure for one in result.health}.get("background_pressed") for result in results
        ]
        rows[f"{name}, background_pressed"] = row(
            no=[one is not None for one in pressed], figures=[one for one in pressed if one is not None]
        )
    return shown("hard object beyond 2 N", rows)


def unknown(run: Run) -> dict[str, Row]:
    """Frames a third of whose imprint is unknown, without `contact_unknown`; known ones that have it."""
    reconstruct = gelform.Reconstructor(own(run, "homemade-hd"))
    judged = []
    for path in run.some(sorted((DATA / "homemade-hd" / "frames").glob("*.jpg"))):
        image = gelform.read_image(path)
        result = reconstruct.from_image(image)
        region = imprint(image, reconstruct.background)
        share = float(np.mean(~result.known[region])) if region.any() else 0.0
        named = {one.name: one.figure for one in result.health}
        judged.append((share, named.get("contact_unknown")))
    figures = [said for _, said in judged if said is not None]
    lost = [said is None for share, said in judged if share >= UNKNOWN_SHARE]
    seen = [said is not None for share, said in judged if share < KNOWN_SHARE]
    return shown("imprint a third unknown", {"homemade-hd": row(no=seen, yes=lost, figures=figures)})


def imprint(image: np.ndarray, at_rest: np.ndarray) -> np.ndarray:
    """The outline (H, W) of the largest imprint: where the color differs from that of rest and of the light around it.

    It knows no gelform: on each of the 33 frames it was compared with the picture by eye.
    """
    scale = image.shape[0] / ROWS
    smooth = (
        cv2.GaussianBlur(np.asarray(a, dtype=np.float32), (0, 0), FINE * scale) for a in (image, at_rest)
    )
    one, other = (np.log(a + DARK_LEVELS) for a in smooth)
    change = cv2.resize(one - other, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA)
    change -= np.median(change, axis=(0, 1))
    percents = np.clip(np.rint(100 * change + 128), 0, 255).astype(np.uint8)
    around = [cv2.medianBlur(np.ascontiguousarray(percents[..., k]), AROUND) for k in range(3)]
    change -= (np.dstack(around).astype(np.float32) - 128) / 100
    mask = (np.linalg.norm(change, axis=-1) > CHANGED).astype(np.uint8)
    for act, size in ((cv2.MORPH_OPEN, OPENED), (cv2.MORPH_CLOSE, CLOSED)):
        mask = cv2.morphologyEx(mask, act, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    drawn = np.zeros_like(mask)
    largest = max(outlines, key=cv2.contourArea, default=None)
    if largest is not None:
        cv2.fillPoly(drawn, [largest], 1)
    if drawn.mean() < LEAST_SHARE:
        drawn[:] = 0
    return cv2.resize(drawn, image.shape[1::-1], interpolation=cv2.INTER_NEAREST).astype(bool)
