"""Part of real_frames.py: outlines on plane faces, of a cube's edge on a real Mini and of simulated flat punches."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

import gelform
from faces_of_cube import ENDS, touched_faces
from gelform.simulate import LAYOUTS, Punch, simulate_press
from presses import DATA
from real_frames.sets import Run, background_of
from real_frames.simulated import REPORTED
from report import table

NEAR_PX = 4  # from the faces; what is further out counts as outside
INNER_PX = 2  # from the rim of a punch; holes are counted within
PUNCHES, DEPTHS_MM = 36, (0.05, 0.15, 0.5)
SEED = 20261128


def faces(run: Run) -> dict[str, Any]:
    """How much of a cube's touched faces, and of flat punches, the contact covers; how much of it is outside; its holes."""
    background = background_of("mini-edge")
    reconstruct = gelform.Reconstructor(run.carried("starter", background))
    cube = []
    for name in run.some(list(ENDS)):
        image = gelform.read_image(DATA / "mini-edge" / "images" / name)
        truth = touched_faces(image, background, np.array(ENDS[name]))
        cube.append(outlined(reconstruct.from_image(image).contact, truth, NEAR_PX))
    figures = {"cube by the starter": summary(cube)}
    figures |= {f"flat punch, {name}": _punches(run, name) for name in REPORTED}
    header = ["faces", *next(iter(figures.values()))]
    print("\n" + table(header, [[k, *v.values()] for k, v in figures.items()]), flush=True)
    return figures


def _punches(run: Run, name: str) -> dict[str, float]:
    reconstruct, rng, rows = gelform.Reconstructor(run.layout(name)), np.random.default_rng(SEED), []
    for k in range(run.frames(PUNCHES)):
        size, place = float(rng.uniform(3, 8)), tuple(rng.uniform(-2, 2, 2).tolist())
        punch = Punch(size) if k % 2 else Punch(size, float(rng.uniform(2, size)))
        truth = simulate_press(
            LAYOUTS[name], punch, depth_mm=DEPTHS_MM[k % len(DEPTHS_MM)], center_mm=place, rng=rng, oversample=1,
            spin_deg=float(rng.uniform(0, 180)),
        )  # fmt: skip
        inner = cv2.erode(truth.contact.astype(np.uint8), _square(INNER_PX)) > 0
        rows.append(outlined(reconstruct.from_image(truth.image).contact, truth.contact, NEAR_PX, inner))
    return summary(rows)


def outlined(
    contact: np.ndarray, truth: np.ndarray, near_px: int, inner: np.ndarray | None = None
) -> tuple[float, float, float, int]:
    """Share of the true pixels that are covered, share of the contact far outside, overlap, and number of holes.

    A hole is a connected region without contact: of `inner`, or of what does not reach the frame's border.
    """
    near = cv2.dilate(truth.astype(np.uint8), _square(near_px)) > 0
    both = np.count_nonzero(contact & truth)
    if inner is None:
        around = np.pad(~contact, 1, constant_values=True)  # what reaches the border is one region
        holes = cv2.connectedComponents(around.astype(np.uint8), connectivity=4)[0] - 2
    else:
        holes = cv2.connectedComponents((inner & ~contact).astype(np.uint8), connectivity=4)[0] - 1
    outside = np.count_nonzero(contact & ~near) / max(np.count_nonzero(contact), 1)
    return both / np.count_nonzero(truth), outside, both / np.count_nonzero(contact | truth), holes


def summary(rows: list[tuple[float, float, float, int]]) -> dict[str, float]:
    """Figures of all frames."""
    covered, outside, overlap, holes = np.array(rows, dtype=np.float64).T
    return {
        "frames": len(rows),
        "covered, median": float(np.median(covered)),
        "covered, least": float(covered.min()),
        "outside, median": float(np.median(outside)),
        "outside, most": float(outside.max()),
        "intersection over union": float(np.median(overlap)),
        "holes a frame": float(holes.mean()),
    }


def _square(reach: int) -> np.ndarray:
    return np.ones((2 * reach + 1,) * 2, np.uint8)
