"""Twin: simulated presses that look like those of one real sensor, rendered by its calibration's forward response."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from gelform.arrays import Array, Image, Map, Numbers
from gelform.calibration_file import Calibration
from gelform.foundations.checks import check_positive
from gelform.image.background import image_from_color_change
from gelform.simulate.gel import Gel
from gelform.simulate.indenters import Indenter, Pose
from gelform.simulate.light import draws, normal_table, saturated_from_levels
from gelform.simulate.press import SimulatedPress, SimulatedPresses, simulate_ball_presses, simulate_pose
from gelform.simulate.sensor import Led, SimulatedSensor

STEEPEST_RENDERED = 1.2  # mm/mm; calibrations are fitted up to about 1, and a cubic is meaningless beyond


class Look(Protocol):
    """The response of one sensor to a surface, which a twin shows."""

    @property
    def name(self) -> str: ...  # of the sensor
    @property
    def background(self) -> Map: ...  # (H, W, 3), background image
    @property
    def mm_per_px(self) -> float: ...
    @property
    def noise(self) -> Numbers: ...  # (3,), standard deviation of an image's pixel, gray levels

    def levels(self, gradients: Array, depth_mm: Array) -> Map:
        """Gray levels (H, W, 3), 0-255, for slopes (H, W, 2) and depths (H, W)."""
        ...


class CalibratedLook:
    """The look that a calibration has learned: its forward response to slope and depth.

    An imported response may depend on slope alone. The noise is that of the calibration's images, or that of its background
    if the former is unknown. Slopes over `steepest` are rendered with it, because the response was fitted on gentler ones.
    """

    def __init__(self, calibration: Calibration, *, steepest: float = STEEPEST_RENDERED) -> None:
        pitch_x, pitch_y = np.broadcast_to(np.asarray(calibration.known_mm_per_px, dtype=np.float64), 2)
        if abs(pitch_x / pitch_y - 1) > 1e-6:
            raise ValueError(
                f"Expected a calibration of square pixels, got mm_per_px={calibration.mm_per_px}."
            )
        self.calibration = calibration
        self.steepest = check_positive(steepest, "steepest")
        self.name = calibration.sensor_name
        self.background = calibration.background
        self.mm_per_px = float(pitch_x)
        known = calibration.settings.image_noise
        self.noise = np.asarray(calibration.background_noise if known is None else known, dtype=np.float64)

    def levels(self, gradients: Array, depth_mm: Array) -> Map:
        change = self.color_change(gradients, depth_mm)
        return image_from_color_change(change, self.background, self.calibration.change)

    def color_change(self, gradients: Array, depth_mm: Array) -> Map:
        """Expected color change (H, W, 3) for gradients (H, W, 2), with a limit on steep ones, and depths (H, W)."""
        steepness = np.linalg.norm(gradients, axis=-1, keepdims=True)
        limited = gradients * np.minimum(1, self.steepest / np.maximum(steepness, 1e-12))
        forward = self.calibration.forward
        if forward is None:
            return self.calibration.color_from_gradients(limited)
        y, x = (axis.ravel() for axis in np.mgrid[: depth_mm.shape[0], : depth_mm.shape[1]])
        depth_px = depth_mm.ravel() / self.mm_per_px
        change = forward.color_from_gradients(limited.reshape(-1, 2), x, y, depth_px=depth_px)
        return change.reshape(*depth_mm.shape, 3).astype(np.float32)


class Twin:
    """A simulated sensor with the response of a real one, as far as its calibration or its tables describe it.

    The surface comes from the simulator's gel, and everything visible from the look. Dust and scratches are in its
    background. Cast shadows are missing, because they depend on more than slope and depth at a pixel.

    Parameters
    ----------
    look : a Calibration, or any `Look`, such as another package's tables
    gel, relaxation_mm : of its gel; by default of a GelSight Mini's, fitted to ball presses
    """

    def __init__(
        self, look: Calibration | Look, *, gel: Gel | None = None, relaxation_mm: float = 0.5
    ) -> None:
        if not isinstance(look, Calibration) and not hasattr(look, "levels"):
            raise TypeError(
                f"Expected a Calibration or a look with `levels`, got {type(look).__name__}. "
                "From a file: gelform.load_calibration(path)."
            )
        self.look: Look = CalibratedLook(look) if isinstance(look, Calibration) else look
        height, width = self.look.background.shape[:2]
        self.sensor = SimulatedSensor(
            (Led((0.0, 0.0, 1e3), (1.0, 1.0, 1.0)),),
            name=f"like {self.look.name}",
            shape=(height, width),
            mm_per_px=self.look.mm_per_px,
            relaxation_mm=relaxation_mm,
            gel=gel or Gel(thickness_mm=3.5, bulge=0.5),
        )

    def press(
        self, indenter: Indenter, pose: Pose, *, rng: np.random.Generator | None, oversample: int = 1
    ) -> SimulatedPress:
        """The image of an indenter at a pose, and its truth."""
        return self.rendered(simulate_pose(self.sensor, indenter, pose, rng=None, oversample=oversample), rng)

    def ball_presses(
        self, *, ball_diameters_mm: Sequence[float], count: int, rng: np.random.Generator
    ) -> SimulatedPresses:
        """A background and presses of balls spread over the image, as `simulate_ball_presses` makes them."""
        made = simulate_ball_presses(
            self.sensor, ball_diameters_mm=ball_diameters_mm, count=count, rng=rng, oversample=1
        )
        presses = tuple(self.rendered(press, rng) for press in made.presses)
        return replace(made, background=self.background, presses=presses)

    @property
    def background(self) -> Image:
        """The background image, without noise."""
        return _gray(self.look.background)

    def rendered(self, press: SimulatedPress, rng: np.random.Generator | None) -> SimulatedPress:
        """A press of the twin's sensor with the look's image; `rng` is for its noise, None for none."""
        levels = self.look.levels(press.gradients, press.depth_mm)
        if rng is not None:
            drawn = normal_table()[draws(rng, levels.size)].reshape(levels.shape)
            levels = levels + drawn * self.look.noise.astype(np.float32)
        nowhere = np.zeros(press.contact.shape, dtype=bool)
        return replace(press, image=_gray(levels), shadowed=nowhere, saturated=saturated_from_levels(levels))


def _gray(levels: Array) -> Image:
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)
