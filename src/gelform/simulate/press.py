"""Simulated presses: one call from a sensor and an indenter to an image with its truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.foundations.checks import check_positive
from gelform.simulate.gel.ball_press import ball_press
from gelform.simulate.gel.gel import (
    Drag,
    Surface,
    displacement_at,
    flat_surface,
    surface_from_indenter,
)
from gelform.simulate.indenters.faces import Ball, Indenter
from gelform.simulate.indenters.pose import Pose, Posed
from gelform.simulate.render import Rendered, render
from gelform.simulate.sensor.camera import px_from_mm
from gelform.simulate.sensor.sensor import SimulatedSensor


@dataclass(frozen=True)
class SimulatedPress(Rendered):
    """An image and its truth, on the image's grid.

    Attributes
    ----------
    image : (H, W, 3) uint8, or float64 where not quantized, RGB
    depth_mm : (H, W) float64, the surface at the pixels' centers, positive where pressed
    gradients : (H, W, 2) float64, its slopes there, mm/mm
    contact : (H, W) bool
    indenter : the pressed indenter
    center_mm : (x, y), position of its center, mm from the gel's center
    center_px : (x, y), the same in pixels
    press_depth_mm : float
        Depth of its foremost point in the gel.
    contact_radius_px : float or None
        Radius of the circle in which gel and ball touch; None for other indenters.
    albedo : (H, W) float32, reflectance with dust and markers; 1 is the clean coating
    shadowed : (H, W) bool, where at least half of some light is lost to the surface
    saturated : (H, W) bool, where some channel is cut at 0 or 255
    markers_px : (N, 2), positions of the markers, x and y; some lie outside the image
    markers_shift_mm : (N, 2), their displacement from rest
    pose : Pose
    time_s : float, time since the LEDs were switched on
    """

    indenter: Indenter
    center_mm: tuple[float, float]
    center_px: tuple[float, float]
    press_depth_mm: float
    contact_radius_px: float | None
    markers_shift_mm: NDArray[np.float64]
    pose: Pose
    time_s: float = 0.0

    @property
    def normals(self) -> NDArray[np.float64]:
        """Unit normals (H, W, 3), n_z > 0."""
        n = np.concatenate([-self.gradients, np.ones_like(self.gradients[..., :1])], axis=-1)
        return np.asarray(n / np.linalg.norm(n, axis=-1, keepdims=True), dtype=np.float64)

    @property
    def ball_diameter_mm(self) -> float:
        """Diameter of the pressed ball; an error for any other indenter."""
        if not isinstance(self.indenter, Ball):
            raise ValueError(f"Expected the press of a ball, got one of a {type(self.indenter).__name__}.")
        return 2 * self.indenter.radius_mm


def simulate_press(
    sensor: SimulatedSensor,
    indenter: Indenter,
    *,
    depth_mm: float,
    center_mm: tuple[float, float] = (0.0, 0.0),
    rng: np.random.Generator | None,
    spin_deg: float = 0.0,
    tilt_deg: tuple[float, float] = (0.0, 0.0),
    oversample: int = 3,
    quantise: bool = True,
) -> SimulatedPress:
    """The image of an indenter pressed into the gel, and its truth.

    Light is computed on a grid `oversample` times finer and averaged over each pixel; the truth is that
    grid's middle sample: the surface at the pixel's center.

    Parameters
    ----------
    depth_mm : float
        Depth of the indenter's foremost point in the gel.
    center_mm : (x, y)
        Position of the indenter, from the gel's center, x to the right, y down.
    rng : Generator or None
        For the noise; None: no noise.
    spin_deg, tilt_deg : float, (about x, about y)
        Turn of the indenter; see `Posed`.
    oversample : odd int
    quantise : bool
        False: float64 levels, neither rounded nor cut at 0 and 255.

    Raises
    ------
    ValueError
        A depth that is not positive or goes through the gel, an even oversample, or an indenter that does
        not touch the gel within the image.
    """
    check_positive(depth_mm, "depth_mm")
    pose = Pose(depth_mm, center_mm, spin_deg, tilt_deg)
    press = simulate_pose(
        sensor, indenter, pose, rng=rng, oversample=oversample, quantise=quantise, drag=Drag(sensor.gel)
    )
    if not press.contact.any():
        height, width = (n * sensor.mm_per_px for n in sensor.shape)
        raise ValueError(
            f"Expected an indenter that touches the gel within the image, got none at center_mm={center_mm} "
            f"pressed {depth_mm:g} mm: the image spans {width:.3g} x {height:.3g} mm."
        )
    return press


def check_press_depth(sensor: SimulatedSensor, depth_mm: float) -> None:
    """Refuse (ValueError) a press through the gel."""
    if depth_mm >= sensor.gel.thickness_mm:
        raise ValueError(
            f"Expected depth_mm less than the gel's thickness, {sensor.gel.thickness_mm:g} mm, got {depth_mm:g}."
        )


def simulate_pose(
    sensor: SimulatedSensor,
    indenter: Indenter,
    pose: Pose,
    *,
    rng: np.random.Generator | None,
    oversample: int = 1,
    quantise: bool = True,
    drag: Drag | None = None,
    time_s: float = 0.0,
) -> SimulatedPress:
    """The image of an indenter at a pose, touching or not, and its truth.

    `drag` remembers the earlier poses; without it the gel is not dragged.
    """
    if oversample < 1 or oversample % 2 == 0:
        raise ValueError(f"Expected oversample as an odd number (1, 3, 5), got {oversample}.")
    check_press_depth(sensor, pose.depth_mm)
    surface = _pressed(sensor, indenter, pose, oversample)
    rest = sensor.coating.markers_mm(sensor.shape, sensor.mm_per_px)
    shift = np.zeros_like(rest)
    if len(rest):
        coarse = surface.middles(oversample).middles(4)  # drag is smooth over the gel's thickness
        shift = displacement_at((drag or Drag(sensor.gel))(coarse, pose), coarse, rest)
    rendered = render(
        sensor,
        surface,
        rng=rng,
        oversample=oversample,
        quantise=quantise,
        markers_mm=rest + shift,
        time_s=time_s,
    )
    radius_mm, rim_mm = _rim(sensor, indenter, pose.depth_mm)
    center = px_from_mm(sensor, np.array([pose.center_mm]), rim_mm)[0]
    return SimulatedPress(
        **vars(rendered),
        indenter=indenter,
        center_mm=pose.center_mm,
        center_px=(float(center[0]), float(center[1])),
        press_depth_mm=pose.depth_mm,
        contact_radius_px=None if radius_mm is None else radius_mm / sensor.mm_per_px,
        markers_shift_mm=shift,
        pose=pose,
        time_s=time_s,
    )


def _pressed(sensor: SimulatedSensor, indenter: Indenter, pose: Pose, oversample: int) -> Surface:
    """The gel's surface on the subpixel grid; all faces but a ball's are solved on a wider grid."""
    if pose.depth_mm <= 0:
        return flat_surface(*sensor.grid_mm(oversample))
    press: dict[str, Any] = {"center_mm": pose.center_mm, "depth_mm": pose.depth_mm}
    press |= {"relaxation_mm": sensor.relaxation_mm, "gel": sensor.gel}
    if isinstance(indenter, Ball):
        return surface_from_indenter(indenter, *sensor.grid_mm(oversample), **press)
    # The gel extends four relaxation lengths beyond the image, where e^-4 = 2 % is left.
    margin = int(np.ceil(4 * sensor.relaxation_mm / sensor.mm_per_px * oversample))
    turned = pose.spin_deg != 0 or pose.tilt_deg != (0, 0)
    posed = Posed(indenter, pose.spin_deg, pose.tilt_deg) if turned else indenter
    wide = surface_from_indenter(posed, *sensor.grid_mm(oversample, margin), **press)
    return wide.sampled(slice(margin, -margin or None))


def _rim(sensor: SimulatedSensor, indenter: Indenter, depth_mm: float) -> tuple[float | None, float]:
    """Contact radius of a ball in the image, and the depth of the rim, mm; None and 0 for others."""
    if not isinstance(indenter, Ball) or depth_mm <= 0:
        return None, 0.0
    gel, radius = sensor.gel, indenter.radius_mm
    lengths = {"thickness_mm": gel.thickness_mm, "bulge": gel.bulge}
    a = ball_press(radius, depth_mm, sensor.relaxation_mm, **lengths).contact_radius_mm
    rim = depth_mm - radius + float(np.sqrt(radius**2 - a**2))
    height = sensor.optics.height_mm
    return (a if height is None else a / (1 - rim / height)), rim
