"""One call from a sensor and an indenter to an image with its truth; and sets of ball presses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.checks import check_positive
from gelform.simulate.camera import image_from_levels, levels_from_irradiance
from gelform.simulate.gel import (
    Surface,
    contact_radius_of_ball,
    cropped,
    depth_of_ball,
    flat_surface,
    surface_from_ball,
    surface_from_indenter,
)
from gelform.simulate.indenters import Ball, Indenter
from gelform.simulate.light import irradiance_from_surface
from gelform.simulate.sensor import SimulatedSensor, Triple

MARGIN_LENGTHS = 4  # the gel reaches this many relaxation lengths beyond the image: e^-4 = 2 % is left there
RIM_SLOPES = (0.5, 0.95)
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class SimulatedPress:
    """An image and the truth behind it, on the image's grid.

    Attributes
    ----------
    image : (H, W, 3) uint8, or float64 where not quantised, RGB
    depth_mm : (H, W) float64, the surface at the pixels' centres, >= 0, positive where pressed
    gradients : (H, W, 2) float64, its slopes there, mm/mm
    contact : (H, W) bool
    indenter : what was pressed
    center_mm : (x, y), where its centre was, mm from the gel's centre
    center_px : (x, y), the same in pixels
    press_depth_mm : float
        How far its foremost point stood in the gel.
    contact_radius_px : float or None
        Of the circle in which gel and ball touch; None for other indenters.
    """

    image: NDArray[Any]
    depth_mm: NDArray[np.float64]
    gradients: NDArray[np.float64]
    contact: NDArray[np.bool_]
    indenter: Indenter
    center_mm: tuple[float, float]
    center_px: tuple[float, float]
    press_depth_mm: float
    contact_radius_px: float | None

    @property
    def normals(self) -> NDArray[np.float64]:
        """Unit normals (H, W, 3), n_z > 0."""
        n = np.concatenate([-self.gradients, np.ones_like(self.gradients[..., :1])], axis=-1)
        return np.asarray(n / np.linalg.norm(n, axis=-1, keepdims=True), dtype=np.float64)

    @property
    def ball_diameter_mm(self) -> float:
        """Of the ball that was pressed; an error for anything else."""
        if not isinstance(self.indenter, Ball):
            raise ValueError(f"Expected the press of a ball, got one of a {type(self.indenter).__name__}.")
        return 2 * self.indenter.radius_mm


@dataclass(frozen=True)
class SimulatedPresses:
    """A background and presses of one simulated sensor: what a press folder holds, and the truth."""

    sensor: SimulatedSensor
    background: NDArray[np.uint8]
    presses: tuple[SimulatedPress, ...]


def simulate_press(
    sensor: SimulatedSensor,
    indenter: Indenter,
    *,
    depth_mm: float,
    center_mm: tuple[float, float] = (0.0, 0.0),
    rng: np.random.Generator | None,
    oversample: int = 3,
    quantise: bool = True,
) -> SimulatedPress:
    """The image of an indenter pressed into the gel, and its truth.

    Light is computed on a grid `oversample` times finer and averaged over each pixel; the truth is that
    grid's middle sample: the surface at the pixel's centre.

    Parameters
    ----------
    depth_mm : float
        How far the indenter's foremost point stands in the gel.
    center_mm : (x, y)
        Of the indenter, from the gel's centre, x to the right, y down.
    rng : Generator or None
        For the noise; None makes none.
    oversample : odd int
    quantise : bool
        False: float64 levels, neither rounded nor cut at 0 and 255.

    Raises
    ------
    ValueError
        A depth that is not positive, an even oversample, or an indenter that does not touch the gel within
        the image.
    """
    check_positive(depth_mm, "depth_mm")
    if oversample < 1 or oversample % 2 == 0:
        raise ValueError(f"Expected oversample as an odd number (1, 3, 5), got {oversample}.")
    surface = _pressed(sensor, indenter, center_mm, depth_mm, oversample)
    if not surface.contact.any():
        raise ValueError(
            f"Expected an indenter that touches the gel within the image, got none at center_mm={center_mm} "
            f"pressed {depth_mm:g} mm: the image spans {_span(sensor)} mm."
        )
    levels = levels_from_irradiance(
        sensor, irradiance_from_surface(surface, sensor.leds, oversample=oversample)
    )
    at = slice(oversample // 2, None, oversample)
    return SimulatedPress(
        image=image_from_levels(sensor, levels, rng, quantise=quantise),
        depth_mm=surface.depth_mm[at, at].copy(),
        gradients=surface.gradients[at, at].copy(),
        contact=surface.contact[at, at].copy(),
        indenter=indenter,
        center_mm=center_mm,
        center_px=sensor.px_from_mm(center_mm),
        press_depth_mm=depth_mm,
        contact_radius_px=_radius_px(sensor, indenter, depth_mm),
    )


def simulate_background(
    sensor: SimulatedSensor, rng: np.random.Generator | None, *, frames: int = 1, quantise: bool = True
) -> NDArray[Any]:
    """The image of the untouched gel, the mean of `frames` images where there are several.

    Returns
    -------
    image : (H, W, 3), uint8; float32 for several frames; float64 where not quantised
    """
    if frames < 1:
        raise ValueError(f"Expected frames >= 1, got {frames}.")
    levels = levels_from_irradiance(
        sensor, irradiance_from_surface(flat_surface(*sensor.grid_mm()), sensor.leds)
    )
    if frames == 1:
        return image_from_levels(sensor, levels, rng, quantise=quantise)
    images = [image_from_levels(sensor, levels, rng, quantise=quantise) for _ in range(frames)]
    mean = np.mean(images, axis=0, dtype=np.float64)
    return np.asarray(mean, dtype=np.float32 if quantise else np.float64)


def simulate_ball_presses(
    sensor: SimulatedSensor,
    *,
    ball_diameters_mm: Sequence[float],
    count: int,
    rng: np.random.Generator,
    oversample: int = 3,
    progress: Progress | None = None,
) -> SimulatedPresses:
    """A background and `count` presses of balls, spread over the image; some are cut by its border.

    The balls take turns. Centres lie on a low-discrepancy sequence that fills the image evenly; depths give
    slopes of 0.5-0.95 at the contact's rim, as a hand that presses a GelSight does. Each press has its own
    random stream, so it does not depend on the others.
    """
    if count < 1 or len(ball_diameters_mm) == 0:
        raise ValueError(f"Expected count >= 1 and a ball, got {count} and {list(ball_diameters_mm)}.")
    background_rng, place_rng, *press_rngs = rng.spawn(count + 2)
    shift = place_rng.random(2)
    presses = []
    for k, press_rng in enumerate(press_rngs):
        ball = Ball(ball_diameters_mm[k % len(ball_diameters_mm)] / 2)
        presses.append(
            simulate_press(
                sensor,
                ball,
                depth_mm=depth_of_ball(ball.radius_mm, press_rng.uniform(*RIM_SLOPES), sensor.relaxation_mm),
                center_mm=_place(sensor, k, shift),
                rng=press_rng,
                oversample=oversample,
            )
        )
        if progress is not None:
            progress(k + 1, count)
    return SimulatedPresses(sensor, simulate_background(sensor, background_rng), tuple(presses))


def exposed(sensor: SimulatedSensor, levels: float | Triple) -> SimulatedSensor:
    """The sensor with the white balance that gives its untouched image these mean grey levels."""
    flat = replace(sensor, white_balance=(1, 1, 1))
    means = simulate_background(flat, None, quantise=False).mean(axis=(0, 1), dtype=np.float64)
    if means.min() <= 0:
        raise ValueError(f"Expected light in every channel, got mean levels {means} for {sensor.name!r}.")
    gains = np.broadcast_to(np.asarray(levels, dtype=np.float64), 3) / means
    return replace(sensor, white_balance=(float(gains[0]), float(gains[1]), float(gains[2])))


def _pressed(
    sensor: SimulatedSensor,
    indenter: Indenter,
    center_mm: tuple[float, float],
    depth_mm: float,
    oversample: int,
) -> Surface:
    length = sensor.relaxation_mm
    if isinstance(indenter, Ball):
        x, y = sensor.grid_mm(oversample)
        return surface_from_ball(indenter, x, y, center_mm=center_mm, depth_mm=depth_mm, relaxation_mm=length)
    margin = int(np.ceil(MARGIN_LENGTHS * length / sensor.mm_per_px * oversample))
    x, y = sensor.grid_mm(oversample, margin)
    wide = surface_from_indenter(indenter, x, y, center_mm=center_mm, depth_mm=depth_mm, relaxation_mm=length)
    return cropped(wide, margin)


def _place(sensor: SimulatedSensor, k: int, shift: NDArray[np.float64]) -> tuple[float, float]:
    """The k-th point of Roberts' R2 sequence (2018), over all but the outermost 2 % of the image."""
    plastic = 1.32471795724474602596
    unit = (shift + (k + 1) / np.array([plastic, plastic**2])) % 1
    height, width = sensor.shape
    x, y = (unit - 0.5) * 0.96 * np.array([width, height]) * sensor.mm_per_px
    return float(x), float(y)


def _radius_px(sensor: SimulatedSensor, indenter: Indenter, depth_mm: float) -> float | None:
    if not isinstance(indenter, Ball):
        return None
    return contact_radius_of_ball(indenter.radius_mm, depth_mm, sensor.relaxation_mm) / sensor.mm_per_px


def _span(sensor: SimulatedSensor) -> str:
    height, width = sensor.shape
    return f"{width * sensor.mm_per_px:.3g} x {height * sensor.mm_per_px:.3g}"
