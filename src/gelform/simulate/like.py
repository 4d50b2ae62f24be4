"""Presses that look like those of one real sensor: its calibration's forward response, rendered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.background import image_from_color_change
from gelform.checks import check_positive
from gelform.record import Calibration
from gelform.simulate.camera import saturated_from_levels
from gelform.simulate.gel import Gel
from gelform.simulate.indenters import Indenter
from gelform.simulate.motion import Pose
from gelform.simulate.press import SimulatedPress, SimulatedPresses, simulate_ball_presses, simulate_pose
from gelform.simulate.sensor import Led, SimulatedSensor

STEEPEST = 1.2  # calibrations see slopes up to about 1; a cubic response says nothing beyond
_ANY_LIGHT = Led((0.0, 0.0, 1e3), (1.0, 1.0, 1.0))


class Twin:
    """A sensor that answers as a calibration says the real one does.

    The surface comes from the simulator's gel, the colour from `calibration.color_from_gradients`, the
    background is
    the calibration's own, the noise that of its background pixels. Dust, scratches and drift of the real
    sensor are in
    its background; cast shadows, which depend on more than the slope at a pixel, are not made.

    Parameters
    ----------
    calibration : of the real sensor
    gel, relaxation_mm : of its gel
    steepest : float
        Steeper slopes are rendered as this one: the response was fitted on gentler ones.
    """

    def __init__(
        self,
        calibration: Calibration,
        *,
        gel: Gel | None = None,
        relaxation_mm: float = 0.35,
        steepest: float = STEEPEST,
    ) -> None:
        pitch_x, pitch_y = np.broadcast_to(np.asarray(calibration.known_mm_per_px, dtype=np.float64), 2)
        if abs(pitch_x / pitch_y - 1) > 1e-6:
            raise ValueError(
                f"Expected a calibration of square pixels, got mm_per_px={calibration.mm_per_px}."
            )
        self.calibration = calibration
        self.steepest = check_positive(steepest, "steepest")
        self.sensor = SimulatedSensor(
            (_ANY_LIGHT,),
            name=f"like {calibration.sensor_name}",
            shape=calibration.image_shape,
            mm_per_px=float(pitch_x),
            relaxation_mm=relaxation_mm,
            gel=gel or Gel(thickness_mm=3.5, bulge=0.5),
        )

    def press(self, indenter: Indenter, pose: Pose, *, rng: np.random.Generator | None) -> SimulatedPress:
        """The image of an indenter at a pose, and its truth."""
        return self._rendered(simulate_pose(self.sensor, indenter, pose, rng=None), rng)

    def ball_presses(
        self, *, ball_diameters_mm: Sequence[float], count: int, rng: np.random.Generator
    ) -> SimulatedPresses:
        """A background and presses of balls spread over the image, as `simulate_ball_presses` makes them."""
        made = simulate_ball_presses(
            self.sensor, ball_diameters_mm=ball_diameters_mm, count=count, rng=rng, oversample=1
        )
        presses = tuple(self._rendered(press, rng) for press in made.presses)
        return replace(made, background=_grey(self.calibration.background), presses=presses)

    def color_change(self, gradients: NDArray[Any]) -> NDArray[np.float32]:
        """Expected color change (H, W, 3) of gradients (H, W, 2), the steep ones made less so."""
        steepness = np.linalg.norm(gradients, axis=-1, keepdims=True)
        limited = gradients * np.minimum(1, self.steepest / np.maximum(steepness, 1e-12))
        return self.calibration.color_from_gradients(limited)

    def _rendered(self, press: SimulatedPress, rng: np.random.Generator | None) -> SimulatedPress:
        calibration = self.calibration
        change = self.color_change(press.gradients)
        levels = image_from_color_change(change, calibration.background, calibration.change)
        if rng is not None:
            noise = calibration.background_noise * rng.standard_normal(levels.shape)
            levels = levels + noise.astype(np.float32)
        nowhere = np.zeros(press.contact.shape, dtype=bool)
        return replace(press, image=_grey(levels), shadowed=nowhere, saturated=saturated_from_levels(levels))


def _grey(levels: NDArray[Any]) -> NDArray[np.uint8]:
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)
