"""An exactly known gel: three fixed lights on a Lambertian surface, a ball pressed in, without any fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from gelform.calibration_file import Calibration
from gelform.image.background import ChangeSettings
from gelform.image.view import View
from gelform.slopes.color_models.forward_response import TERMS, ForwardResponse, normal_terms
from gelform.slopes.color_models.physical import LambertianModel
from gelform.slopes.color_models.seam import monomial_products, monomials, node_positions
from gelform.slopes.sigma import SlopeSigma

SHAPE = (64, 80)
MM_PER_PX = 0.1
LIGHTS = np.array([[0.6, 0.1, 1.0], [-0.35, 0.5, 1.0], [-0.2, -0.6, 1.0]])


@dataclass(frozen=True)
class Touch:
    """A ball of radius_mm, depth_mm deep at (x, y) px, and the image's seed."""

    radius_mm: float = 4.0
    depth_mm: float = 0.4
    x_px: float = 40.0
    y_px: float = 30.0
    seed: int = 1


@cache
def background() -> np.ndarray:
    """(H, W, 3) float32: what many frames of the untouched gel average to."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / SHAPE[1]
    waves = 6 * np.sin(9 * x + 4 * y)
    levels = np.stack([70 + 60 * x + waves, 130 - 50 * y, 80 + 50 * (1 - x) * y - waves], axis=-1)
    levels.setflags(write=False)
    return levels.astype(np.float32)


def depth_of(touch: Touch) -> np.ndarray:
    """(H, W) float64, mm: a cap, and gel at rest around it."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    square = ((x - touch.x_px) ** 2 + (y - touch.y_px) ** 2) * MM_PER_PX**2
    cap = np.sqrt(np.maximum(touch.radius_mm**2 - square, 0)) - (touch.radius_mm - touch.depth_mm)
    return np.maximum(cap, 0)


def image_of(touch: Touch | None) -> np.ndarray:
    """(H, W, 3) uint8, with a camera's noise; None: nothing touches."""
    depth = np.zeros(SHAPE) if touch is None else depth_of(touch)
    slope_y, slope_x = np.gradient(depth, MM_PER_PX)
    normals = np.stack([-slope_x, -slope_y, np.ones(SHAPE)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    light = background() * np.maximum(normals @ LIGHTS.T, 0)
    noise = np.random.default_rng(0 if touch is None else touch.seed).normal(0, 1, light.shape)
    return np.clip(np.rint(light + noise), 0, 255).astype(np.uint8)


def save(path: Path, image: np.ndarray) -> None:
    """An RGB image as a file, in a folder that is made where there is none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(path.suffix, image[..., ::-1])[1].tobytes())


@cache
def calibration(signs: tuple[int, int] = (1, 1)) -> Calibration:
    """What calibrating perfectly would give; with a sign of -1, of the gel whose x or y axis points the other way."""
    return Calibration(
        sensor_name="known gel",
        serial=None,
        gel_id=None,
        view=View(),
        image_shape=SHAPE,
        mm_per_px=MM_PER_PX,
        mm_per_px_sigma=0.001,
        background=np.ascontiguousarray(background()[:: signs[1], :: signs[0]]),
        background_noise=np.ones(3),
        change=ChangeSettings(offset=0.0),
        color_model=LambertianModel(LIGHTS * (*signs, 1)),
        forward=None,
        slope_sigma=SlopeSigma(
            rest=0.02,
            per_step=0.03,
            per_slope=1.7,
            shown=(0.5, 0.9),
            full_confidence_sigma=0.06,
            correlation_px=1.0,
        ),
        untouched_change=0.05,
        held_out={},
        training_digests=(),
        settings={},
        library_version="0",
        created_utc="2026-01-01T00:00:00+00:00",
    )


@cache
def stepping(signs: tuple[int, int] = (1, 1)) -> Calibration:
    """The same with the forward response of these lights, a step by it, and what is known of slopes after one."""
    slopes = np.stack([axis.ravel() for axis in np.meshgrid(*(np.linspace(-0.8, 0.8, 41),) * 2)], axis=-1)
    normals = np.concatenate([-slopes, np.ones((len(slopes), 1))], axis=1)
    change = normals @ (LIGHTS * (*signs, 1)).T / np.linalg.norm(normals, axis=1, keepdims=True) - 1
    of_normal = np.stack(monomial_products(normal_terms(slopes).T, monomials(2, 4)), axis=1)
    nodes = np.zeros((*(len(axis) for axis in node_positions(SHAPE)), TERMS, 3))
    nodes[:, :, : of_normal.shape[1]] = np.linalg.lstsq(of_normal, change, rcond=None)[0]
    forward = ForwardResponse(nodes, 0.012**2 * np.eye(3), SHAPE, (0.02, 0.05))
    known = SlopeSigma(
        rest=0.01, per_step=1.2, shown=(0.5, 0.9), full_confidence_sigma=0.04, correlation_px=1.0
    )
    return replace(calibration(signs), forward=forward, slope_sigma=known)


def depth_error(depth_mm: np.ndarray, touch: Touch) -> str | None:
    """What is wrong with a depth, against the truth; None where it is right."""
    truth = depth_of(touch)
    rms = float(np.sqrt(np.mean((depth_mm - truth) ** 2)))
    peak = float(np.abs(depth_mm.max() - truth.max()))
    if rms > 0.02 + 0.1 * touch.depth_mm or peak > 0.03 + 0.2 * touch.depth_mm:
        return f"depth wrong by {rms:.3f} mm RMS, {peak:.3f} mm at its peak of {touch.depth_mm:.2f} mm, no finding"
    return None
