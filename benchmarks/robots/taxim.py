"""The Taxim export: presses that were not used for calibration, rendered by Taxim's formula, against the real images.

It uses real presses (mini-ball, every second one calibrates) if the data are there; else, and with --quick, a
simulated sensor. Gray levels are the mean absolute difference inside three quarters of the contact's radius, where a
ball's slopes are exact.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import gelform
from gelform.exchange.exporters.taxim import save_taxim
from gelform.image.background.change import image_from_color_change
from gelform.result.metrics.ball import ball_gradients
from presses import DATA, Circle, by_name, reference_circles

INSIDE = 0.75  # fraction of the contact's radius


def measure(quick: bool) -> dict[str, Any]:
    """Gray levels of the export and of the forward response itself."""
    on_simulated = quick or not (DATA / "mini-ball").is_dir()
    calibration, held_out = _simulated() if on_simulated else _real()
    with tempfile.TemporaryDirectory() as folder:
        table = save_taxim(calibration, Path(folder) / "taxim")
        taxim, forward = zip(*(_errors(calibration, table, *press) for press in held_out))
    return {
        "presses": "simulated" if on_simulated else "mini-ball",
        "held_out": len(held_out),
        "taxim_gray_levels": float(np.mean(taxim)),
        "forward_gray_levels": float(np.mean(forward)),
        "ratio": float(np.mean(taxim) / np.mean(forward)),
    }


def rows(figures: dict[str, Any]) -> list[tuple[str, Any, Any]]:
    """(figure, required, measured)."""
    of = f"{figures['held_out']} held-out presses ({figures['presses']})"
    return [
        (f"Taxim export: error over the forward response's, {of}", 1.2, figures["ratio"]),
        ("gray levels, Taxim's formula", "-", figures["taxim_gray_levels"]),
        ("gray levels, forward response", "-", figures["forward_gray_levels"]),
    ]


def taxim_image(folder: Path, height_px: np.ndarray) -> np.ndarray:
    """An image (H, W, 3), RGB, of a height map in px by the formula of Si and Yuan (RA-L 2022)."""
    background = cv2.imread(str(folder / "bg.jpg")).astype(float)
    tables = np.load(folder / "polycalib.npz", allow_pickle=False)
    bins = int(tables["bins"])
    along_rows, along_columns = np.gradient(height_px)
    steepness = np.arctan(np.hypot(along_rows, along_columns)) / (np.pi / 2 / (bins - 1))
    direction = (np.arctan2(along_rows, along_columns) + np.pi) / (2 * np.pi / (bins - 1))
    i, j = steepness.astype(int), direction.astype(int)
    y, x = np.indices(height_px.shape)
    place = np.stack([x * x, y * y, x * y, x, y, np.ones(x.shape)], axis=-1)
    change = np.stack([(place * tables[f"grad_{c}"][i, j]).sum(-1) for c in "rgb"], axis=-1)
    return np.clip(background + change, 0, 255)[..., ::-1]


def _errors(
    calibration: gelform.Calibration, table: Path, image: np.ndarray, diameter_mm: float, circle: Circle
) -> tuple[float, float]:
    """Mean differences inside a contact, gray levels, of Taxim's image and of the forward response's."""
    x, y, rim = circle
    radius = diameter_mm / 2 / calibration.known_mm_per_px
    rows_px, columns_px = np.indices(image.shape[:2])
    away = np.hypot(columns_px - x, rows_px - y)
    sphere = np.sqrt(radius**2 - np.minimum(away, rim) ** 2) - np.sqrt(radius**2 - rim**2)
    inside = away < INSIDE * rim
    where = np.nonzero(inside)
    slopes = np.zeros((*image.shape[:2], 2))
    slopes[where] = ball_gradients(where[1], where[0], (x, y), radius)
    forward = image_from_color_change(
        calibration.color_from_gradients(slopes), calibration.background, calibration.change
    )
    real = image[inside].astype(float)
    return tuple(
        float(np.abs(shown[inside] - real).mean()) for shown in (taxim_image(table, sphere), forward)
    )  # type: ignore[return-value]


def _real() -> tuple[gelform.Calibration, list[tuple[np.ndarray, float, Circle]]]:
    presses, circles = gelform.read_presses(DATA / "mini-ball"), reference_circles()
    order = by_name(presses)
    calibration = gelform.calibrate(presses.subset(order[::2]), color_model="polynomial")
    held_out = presses.subset(order[1::2]).presses
    return calibration, [(one.image, one.ball_diameter_mm, circles[one.name]) for one in held_out]


def _simulated() -> tuple[gelform.Calibration, list[tuple[np.ndarray, float, Circle]]]:
    from gelform.simulate import simulate_ball_presses
    from robots.bag import SENSOR, reconstructor

    made = simulate_ball_presses(
        SENSOR, ball_diameters_mm=[4, 6], count=8, rng=np.random.default_rng(5), oversample=1
    )
    held_out = [(p.image, p.ball_diameter_mm, (*p.center_px, p.contact_radius_px)) for p in made.presses]
    return reconstructor().calibration, held_out
