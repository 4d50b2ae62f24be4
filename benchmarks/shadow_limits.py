"""Part of confidence.py: what of the error on sensors that cast shadows is the shadows', by what the simulator knows."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy, deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import gelform
from cast_shadows import both, calibrated, drawn_digit, object_on
from gelform.simulate import SimulatedPress

SEEDS = tuple(range(401, 406))
SHADOW_WEIGHT = 0.03  # as cast shadows are weighed in use
Tell = Callable[[np.ndarray, np.ndarray, np.ndarray], None]


class Told:
    """The causes of a frame, and after them what the simulator knows: changes slopes and confidence in place."""

    def __init__(self, causes: Any, tell: Tell) -> None:
        self._causes, self._tell = causes, tell

    def __call__(
        self,
        image: Any,
        change: Any,
        gradients: Any,
        reference: Any,
        hidden: Any,
        sigma: Any,
        came: Any = None,
    ) -> np.ndarray:
        """Confidence (H, W)."""
        confidence: np.ndarray = self._causes(image, change, gradients, reference, hidden, sigma, came)
        self._tell(gradients, confidence, reference.bias)
        return confidence


def limits(frames: int, folder: Path, seeds: tuple[int, ...] = SEEDS) -> dict[str, Any]:
    """RMS depth error in the contact, um, mean over frames: as in use, without, and with what only the simulator knows.

    `drawn_without`: the same press, its image without a shadow; `doubted`: shadows are known and weighed 0.03;
    `true_in_shadow`: the slopes there, too; `_beside`: of those outside the contact alone; `true_beside`: of all slopes
    beside it, and `true_beside_and_in_shadow`.
    """
    found: dict[str, Any] = {}
    for seed in seeds:
        sensor, path = drawn_digit(seed), folder / f"digit-{seed}.npz"
        if not path.is_file():
            calibrated(sensor, seed).save(path)
        pair, rng = both(gelform.load_calibration(path)), np.random.default_rng(seed + 1)
        rows = []
        for _ in range(frames):
            again = deepcopy(rng)
            _, truth = object_on(sensor, rng)
            _, unshadowed = object_on(replace(sensor, cast_shadows=False), again)
            depths = _depths(*pair, truth, unshadowed.image)
            rows.append([1e3 * _rms(z, truth) for z in depths.values()])
        found[f"sensor {seed}"] = dict(zip(depths, np.mean(rows, axis=0).tolist()))
    return found


def _rms(depth: np.ndarray, truth: SimulatedPress) -> float:
    return float(np.sqrt(np.mean((depth - truth.depth_mm)[truth.contact] ** 2)))


def _depths(
    with_: gelform.Reconstructor,
    without: gelform.Reconstructor,
    truth: SimulatedPress,
    unshadowed: np.ndarray,
) -> dict[str, np.ndarray]:
    shadow = cv2.dilate(truth.shadowed.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    beside = cv2.dilate(truth.contact.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0
    told = {
        "doubted": _doubt(shadow),
        "true_in_shadow": _true(shadow, truth),
        "true_in_shadow_beside": _true(shadow & beside, truth),
        "true_beside": _true(beside, truth),
        "true_beside_and_in_shadow": _true(beside | shadow, truth),
    }
    return {
        "taken_back": with_.from_image(truth.image).depth_mm,
        "without": without.from_image(truth.image).depth_mm,
        "drawn_without": without.from_image(unshadowed).depth_mm,
        **{name: _knowing(without, tell).from_image(truth.image).depth_mm for name, tell in told.items()},
    }


def _knowing(reconstruct: gelform.Reconstructor, tell: Tell) -> gelform.Reconstructor:
    other: Any = copy(reconstruct)
    other._causes = Told(other._causes, tell)
    return other  # type: ignore[no-any-return]


def _doubt(region: np.ndarray) -> Tell:
    def tell(gradients: np.ndarray, confidence: np.ndarray, bias: np.ndarray) -> None:
        confidence[region] = np.minimum(confidence[region], SHADOW_WEIGHT)

    return tell


def _true(region: np.ndarray, truth: SimulatedPress) -> Tell:
    def tell(gradients: np.ndarray, confidence: np.ndarray, bias: np.ndarray) -> None:
        gradients[region], confidence[region] = truth.gradients[region] - bias, 1

    return tell
