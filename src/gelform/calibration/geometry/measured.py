"""Measurements of a sensor before its presses: scale, crosstalk, lens; and their sentences for a report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gelform.calibration.geometry.crosstalk import Crosstalk


@dataclass(frozen=True)
class Geometry:
    """Measurements apart from the presses; none by default.

    Attributes
    ----------
    scale_source : target that mm_per_px was measured on, with the figures; empty: given as a number
    crosstalk : removed before the color model; None: the color model absorbs it
    lens : target that distortion and perspective were measured on, with the residual; empty: none is removed
    gel_thickness_mm : thickness of the gel at rest, mm; None if unknown
    """

    scale_source: str = ""
    crosstalk: Crosstalk | None = None
    lens: str = ""
    gel_thickness_mm: float | None = None

    @classmethod
    def from_settings(cls, measured: Mapping[str, Any], gel_thickness_mm: float | None = None) -> Geometry:
        """Make it from the table `[measured]` of a `sensor.toml` (`SensorSettings.measured`), and the gel's thickness."""
        crosstalk = None
        if "crosstalk" in measured:
            spread = measured.get("crosstalk_spread", ((0.0,) * 3,) * 3)
            crosstalk = Crosstalk(
                *(tuple(tuple(map(float, row)) for row in m) for m in (measured["crosstalk"], spread))
            )
        return cls(measured.get("scale", ""), crosstalk, measured.get("lens", ""), gel_thickness_mm)

    @property
    def matrix(self) -> tuple[tuple[float, ...], ...] | None:
        """The crosstalk to remove, 3x3, or None."""
        return None if self.crosstalk is None else self.crosstalk.matrix

    def settings(self) -> dict[str, Any]:
        """The record of it in a calibration, by the names of `CalibrationSettings`."""
        said: dict[str, Any] = {"scale_source": self.scale_source, "lens": self.lens}
        said["gel_thickness_mm"] = self.gel_thickness_mm
        if self.crosstalk is not None:
            said["crosstalk"] = self.crosstalk.describe()
        return {name: value for name, value in said.items() if value}

    def notes(self, response: float, mm_per_px_sigma: float | None) -> tuple[str, ...]:
        """The sentences of a report about it."""
        sigma = "is not known" if mm_per_px_sigma is None else f"is {mm_per_px_sigma:.2g} mm/px"
        scale = self.scale_source or "the number given"
        notes = [
            f"The scale comes from {scale}. Its standard deviation {sigma}; the errors do not contain it.",
            "The color model absorbs the crosstalk, because there are no frames of single LEDs."
            if self.crosstalk is None
            else f"Before the color model, gelform removes {self.crosstalk.describe()}.",
        ]
        if response != 1:
            notes.append(
                f"gelform removes the camera's response, exponent {response:g}, before the color model."
            )
        if self.lens:
            notes.append(f"gelform corrects the lens: {self.lens}.")
        return tuple(notes)
