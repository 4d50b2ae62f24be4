"""The appearance of the gel's surface: gloss, scattering, roughness, scratches, dust, markers, albedo."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.foundations.checks import check_map, check_positive

Grid = tuple[int, int]


def check_not_negative(settings: Any, *names: str) -> None:
    """Refuse settings of these names that are below 0 or not finite."""
    for name in names:
        if not 0 <= getattr(settings, name) < np.inf:
            raise ValueError(f"Expected {name} >= 0, got {getattr(settings, name)}.")


@dataclass(frozen=True)
class Coating:
    """The reflecting layer on the gel. With all zeros it is perfectly white and Lambertian.

    Attributes
    ----------
    specular : float, >= 0
        Strength of the gloss relative to the diffuse light (Blinn-Phong).
    shininess : int, 1-1024, a power of two
        Exponent of the gloss: larger is sharper.
    scattering : float, 0-1, scattering_mm : float
        Part of the light that spreads in the gel before it is visible, and the length (standard deviation).
    interreflection : float, 0-1, interreflection_mm : float
        Part of the reflected light that returns from gel and walls in one bounce, and the length of its spread.
    roughness : float
        Standard deviation of the coating's own slopes, mm/mm, that shade but are no depth; `grain_mm` is the
        size of the grains.
    scratches, dust : int
        Number of them; dust is dark or bright specks.
    marker_pitch_mm, marker_radius_mm : float
        Dark dots on a grid; 0 pitch: none.
    marker_missing, marker_broken, marker_jitter : float, 0-1
        Fractions of dots that are missing and that lost a piece; distance of dots from the grid, in pitches.
    albedo : (h, w) or None
        Reflectance 0-1 over the image, stretched to its size.
    seed : int
        Seed of this gel's own roughness, scratches and dust; another gel needs another seed.
    """

    specular: float = 0.0
    shininess: int = 16
    scattering: float = 0.0
    scattering_mm: float = 0.5
    interreflection: float = 0.0
    interreflection_mm: float = 5.0
    roughness: float = 0.0
    grain_mm: float = 0.12
    scratches: int = 0
    dust: int = 0
    marker_pitch_mm: float = 0.0
    marker_radius_mm: float = 0.25
    marker_missing: float = 0.0
    marker_broken: float = 0.0
    marker_jitter: float = 0.0
    albedo: Any = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_not_negative(self, "specular", "roughness", "marker_pitch_mm", "scratches", "dust", "seed")
        for name in ("scattering", "interreflection", "marker_missing", "marker_broken", "marker_jitter"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(f"Expected {name} in 0-1 (1 excluded), got {getattr(self, name)}.")
        for name in ("scattering_mm", "interreflection_mm", "grain_mm", "marker_radius_mm"):
            check_positive(getattr(self, name), name)
        if self.shininess not in [2**k for k in range(11)]:
            raise ValueError(f"Expected shininess as a power of two in 1-1024, got {self.shininess}.")
        if 0 < self.marker_pitch_mm <= 2 * self.marker_radius_mm:
            raise ValueError(f"Expected marker_pitch_mm over twice the radius, got {self.marker_pitch_mm}.")
        if self.albedo is not None and not isinstance(self.albedo, _Albedo):
            object.__setattr__(self, "albedo", _Albedo(self.albedo))

    def markers_mm(self, shape: Grid, mm_per_px: float) -> NDArray[np.float64]:
        """Positions (N, 2) of the markers at rest: a grid about the center, to half a pitch beyond the image."""
        if self.marker_pitch_mm == 0:
            return np.zeros((0, 2))
        half_x, half_y = (n * mm_per_px / 2 for n in shape[::-1])
        nx, ny = (int(half / self.marker_pitch_mm + 0.5) for half in (half_x, half_y))
        y, x = np.mgrid[-ny : ny + 1, -nx : nx + 1] * self.marker_pitch_mm
        places = np.stack([x.ravel(), y.ravel()], axis=-1)
        rng = np.random.default_rng([self.seed, 3])
        there = rng.random(len(places)) >= self.marker_missing
        away = rng.uniform(-1, 1, places.shape) * self.marker_jitter * self.marker_pitch_mm / 2
        return (places + away)[there]

    def marker_bites(self, count: int) -> NDArray[np.float64]:
        """Center (N, 2), in radii, of the round piece of 0.6 of its radius that each marker lost; NaN: it is whole."""
        rng = np.random.default_rng([self.seed, 4])
        angle, broken = rng.uniform(0, 2 * np.pi, count), rng.random(count) < self.marker_broken
        bites = 0.85 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return np.where(broken[:, None], bites, np.nan)


class _Albedo:
    """A reflectance map that compares by identity, so that a coating can be a key."""

    def __init__(self, values: ArrayLike) -> None:
        self.values = check_map(values, "albedo", nonnegative=True, dtype=np.float64)
        if self.values.ndim != 2 or self.values.max() > 1:
            raise ValueError(
                f"Expected albedo of shape (h, w) in 0-1, got {self.values.shape}, up to {self.values.max():g}."
            )


@lru_cache(maxsize=8)
def albedo_map(coating: Coating, shape: Grid, mm_per_px: float) -> NDArray[np.float32]:
    """Reflectance (H, W) of a gel without its markers: the albedo map and dust."""
    albedo = np.ones(shape, dtype=np.float32)
    if coating.albedo is not None:
        albedo = cv2.resize(coating.albedo.values, shape[::-1], interpolation=cv2.INTER_LINEAR).astype(
            np.float32
        )
    rng = np.random.default_rng([coating.seed, 1])
    for _ in range(coating.dust):
        at, size = rng.uniform(0, 1, 2) * shape[::-1], rng.uniform(0.04, 0.12) / mm_per_px
        level = rng.choice([rng.uniform(0.3, 0.8), rng.uniform(1.2, 1.8)])
        y, x = np.ogrid[: shape[0], : shape[1]]
        cover = np.clip(size + 0.5 - np.hypot(x - at[0], y - at[1]), 0, 1).astype(np.float32)
        albedo = np.asarray(albedo * (1 + cover * np.float32(level - 1)), dtype=np.float32)
    return albedo


def with_markers(
    albedo: NDArray[np.float32],
    places_px: NDArray[np.float64],
    radius_px: float,
    bites: NDArray[np.float64] | None = None,
) -> NDArray[np.float32]:
    """The reflectance with dark dots at positions (N, 2), x and y, with soft edges; `bites` as `Coating.marker_bites`."""
    out = albedo.copy()
    reach = int(radius_px) + 1
    row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    x, y = (np.rint(places_px[:, k]).astype(np.intp)[:, None, None] for k in (0, 1))
    rows, columns = np.broadcast_arrays(y + row, x + column)
    away = np.hypot(columns - places_px[:, 0, None, None], rows - places_px[:, 1, None, None])
    cover = np.clip(radius_px + 0.5 - away, 0, 1)
    if bites is not None:
        bitten = places_px + radius_px * np.where(np.isnan(bites), 9, bites)
        away = np.hypot(columns - bitten[:, 0, None, None], rows - bitten[:, 1, None, None])
        cover *= 1 - np.clip(0.6 * radius_px + 0.5 - away, 0, 1)
    shown = (cover > 0) & (rows >= 0) & (rows < out.shape[0]) & (columns >= 0) & (columns < out.shape[1])
    np.multiply.at(out, (rows[shown], columns[shown]), (1 - 0.9 * cover[shown]).astype(np.float32))
    return out


@lru_cache(maxsize=8)
def texture_gradients(
    coating: Coating, shape: Grid, mm_per_px: float, oversample: int
) -> NDArray[np.float32] | None:
    """Slopes (h, w, 2) of roughness and scratches on the fine grid, or None where there are none.

    They are made on a grid of the pixels' pitch and stretched, so that the gel is the same for every oversample.
    """
    if coating.roughness == 0 and coating.scratches == 0:
        return None
    height = np.zeros(shape, dtype=np.float32)
    rng = np.random.default_rng([coating.seed, 2])
    if coating.roughness > 0:
        grain = cv2.GaussianBlur(
            rng.standard_normal(shape).astype(np.float32), (0, 0), max(coating.grain_mm / mm_per_px, 0.5)
        )
        slope = np.std(np.gradient(grain, mm_per_px), dtype=np.float64)
        height += grain * np.float32(coating.roughness / slope)
    for _ in range(coating.scratches):
        height -= _scratch(shape, mm_per_px, rng)
    size = (shape[1] * oversample, shape[0] * oversample)
    slopes = [cv2.resize(s, size, interpolation=cv2.INTER_LINEAR) for s in np.gradient(height, mm_per_px)]
    return np.stack(slopes[::-1], axis=-1).astype(np.float32)


def _scratch(shape: Grid, mm_per_px: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """A groove (H, W), 2-8 um deep, 2-6 mm long, straight."""
    start = rng.uniform(0, 1, 2) * shape[::-1]
    angle, length = rng.uniform(0, np.pi), rng.uniform(2, 6) / mm_per_px
    end = start + length * np.array([np.cos(angle), np.sin(angle)])
    drawing = np.zeros(shape, dtype=np.float32)
    points = [(round(float(x)), round(float(y))) for x, y in (start, end)]
    cv2.line(drawing, points[0], points[1], 1.0, 1, cv2.LINE_8)
    depth_mm = np.float32(rng.uniform(0.002, 0.008))
    return np.asarray(cv2.GaussianBlur(drawing, (0, 0), 0.8) * depth_mm, dtype=np.float32)
