"""Part of real_frames.py: presses in another light, made of real and simulated images: exposure, tilt, room light."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

import gelform
from gelform.simulate import LAYOUTS, simulate_ball_presses
from real_frames.sets import Run, percent
from report import table

LAYOUT, PRESSES, SEED = (
    "ring-120",
    6,
    20261126,
)  # of the simulated row, on presses that its calibration has not seen
DEEP, SHALLOW = 0.3, 0.05  # of the peak: pixels of the press itself, and those off it
TILT, ROOM = 0.05, 20.0  # as fractions from the middle to a border, and gray levels
CALLED = ("tilted_light", "room_light", "exposure", "background_ratio", "background_differs")
Change = Callable[[np.ndarray], np.ndarray]


def _plane(image: np.ndarray, axis: int) -> np.ndarray:
    shape = [1, 1, 1]
    shape[axis] = image.shape[axis]
    return 1 + TILT * np.linspace(-1, 1, image.shape[axis]).reshape(shape)


SCENES: dict[str, list[Change]] = {
    "unchanged": [lambda image: image],
    "times 0.9, 0.95, 1.05, 1.1": [lambda image, k=k: k * image for k in (0.9, 0.95, 1.05, 1.1)],  # type: ignore[misc]
    "tilted by 5 %": [lambda image, axis=axis: image * _plane(image, axis) for axis in (0, 1)],  # type: ignore[misc]
    "room light, 20 levels": [lambda image: image + ROOM],
    "both": [lambda image: image * _plane(image, 1) + ROOM],
}


def light(run: Run) -> dict[str, Any]:
    """Change of depth over a press's peak, percent, in another light; frames called so, and depth within its own sigma.

    `moved` is the median over the pixels deeper than 0.3 of the peak; `off` the root mean square where no press is.
    """
    figures: dict[str, Any] = {}
    for name in run.sets:
        images = [press.image for press in run.some(run.presses(name).presses)]
        figures[name] = _of_set(gelform.Reconstructor(run.calibration(name)), images)
    rng = np.random.default_rng(SEED)
    simulated = simulate_ball_presses(
        LAYOUTS[LAYOUT], ball_diameters_mm=[5.0, 8.0], count=PRESSES, rng=rng, oversample=1
    )
    images = [press.image for press in simulated.presses]
    figures[f"simulated, {LAYOUT}"] = _of_set(gelform.Reconstructor(run.layout(LAYOUT)), images)
    rows = [[name, scene, *row.values()] for name, rows in figures.items() for scene, row in rows.items()]
    header = ["set", "light", *next(iter(next(iter(figures.values())).values()))]
    print("\n" + table(header, rows), flush=True)
    return figures


def _of_set(reconstruct: gelform.Reconstructor, images: Iterable[np.ndarray]) -> dict[str, Any]:
    rows: dict[str, list[Any]] = {scene: [] for scene in SCENES}
    for image in images:
        plain = reconstruct.from_image(image)
        for scene, changes in SCENES.items():
            rows[scene] += [
                _in_light(reconstruct, plain, change(image.astype(np.float64))) for change in changes
            ]
    return {scene: _summary(found) for scene, found in rows.items()}


def _in_light(reconstruct: gelform.Reconstructor, plain: Any, image: np.ndarray) -> Any:
    """Changes of depth, pixels within one and two sigma, and findings; None for a frame that is refused."""
    try:
        result = reconstruct.from_image(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    except gelform.GelformError:
        return None
    peak = float(plain.depth_mm.max())
    off, deep = np.abs(result.depth_mm - plain.depth_mm), plain.depth_mm > DEEP * peak
    rest = off[plain.depth_mm < SHALLOW * peak]
    within = [float(np.mean(off[deep] < k * result.depth_sigma_mm[deep])) for k in (1, 2)]
    shares = 100 * np.median(off[deep]) / peak, 100 * float(np.sqrt(np.mean(rest**2))) / peak
    return *shares, *within, {finding.name for finding in result.health} & set(CALLED)


def _summary(found: list[Any]) -> dict[str, Any]:
    kept = [one for one in found if one is not None]
    moved, off, one, two = np.array([row[:4] for row in kept]).T
    names = {name: percent([name in row[4] for row in kept]) for name in CALLED}
    return {
        "frames": len(found),
        "refused": len(found) - len(kept),
        "moved, median": float(np.median(moved)),
        "90 %": float(np.quantile(moved, 0.9)),
        "max": float(moved.max()),
        "off, median": float(np.median(off)),
        "within 1 sigma, %": 100 * float(one.mean()),
        "within 2 sigma, %": 100 * float(two.mean()),
        **{f"{name}, %": share for name, share in names.items()},
    }
