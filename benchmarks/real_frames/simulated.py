"""Part of real_frames.py: what must stay as good on simulated sensors: faint contacts, near ones, outlines."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

import gelform
from confidence.drawn import object_press, press
from gelform.simulate import LAYOUTS, simulate_background, simulate_press
from real_frames.contacts import frames_with_contact
from real_frames.sets import Run, percent
from report import table

FAINT_UM = {"ring-120": 10.0, "three-edges": 10.0, "homemade": 20.0}
REPORTED = ("ring-120", "homemade")  # layouts on which the objects are pressed
FRAMES, PAIRS, OBJECTS = 100, 60, 80
AT_REST = 500  # frames of all layouts
GAP_MM, PAIR_RADIUS_MM, PAIR_DEPTH_MM = 1.0, 1.5, 0.3
OVERLAP = 0.5  # of the true contact's pixels, in a contact that counts as this one
SEED = 20261125


@dataclass(frozen=True)
class TwoBalls:
    """Two equal balls beside each other, in one piece.

    Attributes
    ----------
    radius_mm, apart_mm : radius, and distance of the centers
    """

    radius_mm: float
    apart_mm: float

    def face_mm(self, x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
        """Height (H, W) of the face, mm; minus infinity where there is none."""
        x = np.abs(x_mm) - self.apart_mm / 2
        inside = self.radius_mm**2 - x**2 - y_mm**2
        return np.where(inside > 0, np.sqrt(np.maximum(inside, 0)) - self.radius_mm, -np.inf)


def simulated(run: Run) -> dict[str, Any]:
    """Contacts found at rest, faint presses found, near contacts told apart, and outlines by kind of object."""
    found = {f"{name}, {um:g} um": _faint(run, name, um) for name, um in FAINT_UM.items()}
    pairs = {name: _pairs(run, name) for name in REPORTED}
    overlaps: dict[str, list[float]] = {}
    missed: dict[str, int] = {}
    by_sensor: dict[str, Any] = {}
    for name in REPORTED:
        for kind, scores in _overlaps(run, name).items():
            overlaps.setdefault(kind, []).extend(scores)
            missed[kind] = missed.get(kind, 0) + sum(score == 0 for score in scores)
            by_sensor[f"{name}, {kind}"] = float(np.median(scores))
    figures = {
        "at_rest": {name: _at_rest(run, name) for name in LAYOUTS},
        "found_percent": found,
        "two_seen_percent": pairs,
        "overlap_median": {kind: float(np.median(scores)) for kind, scores in overlaps.items()},
        "overlap_by_sensor": by_sensor,
        "objects": {kind: len(scores) for kind, scores in overlaps.items()},
        "not_found": missed,
    }
    rows = [[what, json.dumps(values)] for what, values in figures.items()]
    print("\n" + table(["simulated", ""], rows), flush=True)
    return figures


def _at_rest(run: Run, name: str) -> dict[str, float]:
    rng, count = np.random.default_rng(SEED), run.frames(AT_REST // len(LAYOUTS) + 1)
    images = [simulate_background(LAYOUTS[name], rng) for _ in range(count)]
    return frames_with_contact(run.layout(name), images)


def _faint(run: Run, name: str, depth_um: float) -> float:
    """Share of presses of a ball of one depth with a contact that covers half of the true one, percent."""
    reconstruct, rng = gelform.Reconstructor(run.layout(name)), np.random.default_rng(SEED)
    hits = []
    for _ in range(run.frames(FRAMES)):
        truth = press(name, rng, (depth_um / 1e3, depth_um / 1e3))
        hits.append(label_over(reconstruct.from_image(truth.image), truth.contact) > 0)
    return percent(hits)


def label_over(result: Any, true: np.ndarray) -> int:
    """The label of the contact that covers half of the true one; 0 if none does."""
    counts = np.bincount(result.contact_labels[true], minlength=2)
    label = 1 + int(counts[1:].argmax())
    return label if counts[label] >= OVERLAP * true.sum() else 0


def _pairs(run: Run, name: str) -> float:
    """Share of presses of two balls, the edges of whose contacts are 1 mm apart, seen as two contacts, percent."""
    sensor, reconstruct = LAYOUTS[name], gelform.Reconstructor(run.layout(name))
    rng, hits = np.random.default_rng(SEED), []
    one = simulate_press(sensor, TwoBalls(PAIR_RADIUS_MM, 0), depth_mm=PAIR_DEPTH_MM, rng=rng).contact
    apart = GAP_MM + 2 * float(np.sqrt(one.sum() / np.pi)) * sensor.mm_per_px
    for _ in range(run.frames(PAIRS)):
        center, spin = rng.uniform(-3, 3, 2), float(rng.uniform(0, 180))
        truth = simulate_press(
            sensor, TwoBalls(PAIR_RADIUS_MM, apart), depth_mm=PAIR_DEPTH_MM, rng=rng, spin_deg=spin,
            center_mm=(float(center[0]), float(center[1])), oversample=1,
        )  # fmt: skip
        count, labels = cv2.connectedComponents(truth.contact.astype(np.uint8))
        assert count == 3, f"expected two true contacts, got {count - 1}"
        result = reconstruct.from_image(truth.image)
        seen = {label_over(result, labels == k) for k in (1, 2)}
        hits.append(len(result.contacts) == 2 and len(seen - {0}) == 2)
    return percent(hits)


def _overlaps(run: Run, name: str) -> dict[str, list[float]]:
    """Intersection over union of the contact mask and the pixels that the indenter touches, by kind of object."""
    reconstruct, rng = gelform.Reconstructor(run.layout(name)), np.random.default_rng(SEED)
    scores: dict[str, list[float]] = {}
    for _ in range(run.frames(3 * OBJECTS)):
        kind, truth = object_press(name, rng)
        mask = reconstruct.from_image(truth.image).contact
        union = np.count_nonzero(mask | truth.contact)
        scores.setdefault(kind, []).append(float(np.count_nonzero(mask & truth.contact) / union))
    return scores
