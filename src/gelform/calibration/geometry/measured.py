"""Measurements of a sensor before its presses: crosstalk from single LEDs; and sentences of all for a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.errors import DataError
from gelform.foundations.checks import check_image, check_list
from gelform.image.background import ChangeSettings, linear_light
from gelform.image.view import BRIGHT

NAMES = ("red", "green", "blue")
MIN_LEVEL = 20.0  # gray levels that are usable for a ratio
MIN_USABLE = 0.3  # smallest fraction of usable pixels


@dataclass(frozen=True)
class Crosstalk:
    """Crosstalk of a camera's channels."""

    # 3x3, row c, column k: light of LED k in channel c over the same in channel k; the diagonal is 1
    matrix: tuple[tuple[float, ...], ...]
    # 3x3, standard deviation of each over 4x4 parts of the image. One matrix for the whole image has this error: filters act
    # alike everywhere, but scattered and ambient light vary.
    spread: tuple[tuple[float, ...], ...]

    def describe(self) -> str:
        """One line with the figures."""
        apart = np.asarray(self.matrix) - np.eye(3)
        channel, led = np.unravel_index(int(np.argmax(apart)), (3, 3))
        return (
            f"crosstalk up to {100 * apart.max():.1f} % ({NAMES[led]} light in the {NAMES[channel]} channel), "
            f"constant over the image to within {100 * np.max(self.spread):.1f} %"
        )


def crosstalk_from_frames(
    frames: Sequence[ArrayLike], *, dark: ArrayLike | None = None, response: float = 1.0
) -> Crosstalk:
    """Crosstalk from three frames of the gel at rest: red LEDs alone, green alone, blue alone.

    An element is the median over the pixels of a channel's level over that of the LED's own channel, in linear
    light: three filters that overlap mix the lights by one matrix at every pixel.

    Parameters
    ----------
    frames : three of (H, W, 3), RGB, 0-255; in this order
    dark : (H, W, 3), optional frame with no LED lit, to subtract, because ambient light is no crosstalk
    response : exponent of the camera's response, I = 255 (light/255)^response

    Raises
    ------
    DataError
        A frame is too dark or saturated, or brightest in another channel than its own (the order is wrong).
    """
    frames = check_list(frames, "frames")
    if len(frames) != 3:
        raise ValueError(f"Expected three frames, of the red, green and blue LEDs alone, got {len(frames)}.")
    linear = ChangeSettings(response=response)
    first = check_image(frames[0], name="LED frame")
    images = [check_image(frame, shape=first.shape[:2], name="LED frame") for frame in frames]
    light = [linear_light(image, linear).astype(np.float64) for image in images]
    if dark is not None:
        unlit = linear_light(check_image(dark, shape=first.shape[:2], name="dark frame"), linear)
        light = [one - unlit for one in light]
    columns = [_column(light[k], images[k], k) for k in range(3)]
    matrix, spread = (np.stack([column[i] for column in columns], axis=1) for i in (0, 1))
    return Crosstalk(_rows(matrix), _rows(spread))


def _column(
    light: NDArray[np.float64], image: NDArray[Any], led: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The response of each channel to one LED, and its spread over the image."""
    levels = np.median(light.reshape(-1, 3), axis=0)
    brightest = int(np.argmax(levels))
    listed = ", ".join(f"{name} {level:.0f}" for name, level in zip(NAMES, levels))
    if brightest != led:
        raise DataError(
            f"Expected the {NAMES[led]} LED's frame brightest in {NAMES[led]}, got {listed}. "
            "Give the frames in the order red, green, blue, one LED lit in each."
        )
    usable = (light[..., led] > MIN_LEVEL) & (image.max(axis=-1) < BRIGHT)
    if np.mean(usable) < MIN_USABLE:
        raise DataError(
            f"Expected the {NAMES[led]} LED's frame at levels of {MIN_LEVEL:g}-{BRIGHT}, got {listed} with "
            f"{100 * np.mean(usable):.0f} % of the pixels usable. Change the exposure, the same for all three."
        )
    ratio = light / np.maximum(light[..., led : led + 1], MIN_LEVEL)
    rows, columns = (np.linspace(0, length, 5).astype(int) for length in usable.shape)
    blocks = [np.s_[top:end, left:right] for top, end in pairwise(rows) for left, right in pairwise(columns)]
    parts = [
        np.median(ratio[one][usable[one]], axis=0) for one in blocks if np.mean(usable[one]) > MIN_USABLE
    ]
    return np.median(ratio[usable], axis=0), np.std(parts, axis=0)


def _rows(matrix: Any) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(value) for value in row) for row in matrix)


@dataclass(frozen=True)
class Geometry:
    """Measurements apart from the presses; none by default."""

    scale_source: str = ""  # target that mm_per_px was measured on, with figures; empty: given as a number
    crosstalk: Crosstalk | None = None  # removed before the color model; None: the color model absorbs it
    # target that distortion and perspective were measured on, with the residual; empty: none is removed
    lens: str = ""
    gel_thickness_mm: float | None = None  # thickness of the gel at rest, mm; None if unknown

    @classmethod
    def from_settings(cls, measured: Mapping[str, Any], gel_thickness_mm: float | None = None) -> Geometry:
        """Make it from the table `[measured]` of a `sensor.toml` (`SensorSettings.measured`), and the gel's thickness."""
        crosstalk = None
        if "crosstalk" in measured:
            spread = measured.get("crosstalk_spread", ((0.0,) * 3,) * 3)
            crosstalk = Crosstalk(_rows(measured["crosstalk"]), _rows(spread))
        return cls(measured.get("scale", ""), crosstalk, measured.get("lens", ""), gel_thickness_mm)

    @property
    def matrix(self) -> tuple[tuple[float, ...], ...] | None:
        """The crosstalk to remove, 3x3, or None."""
        return None if self.crosstalk is None else self.crosstalk.matrix

    def settings(self) -> dict[str, Any]:
        """The record of it in a calibration, by the names of `CalibrationSettings`."""
        said: dict[str, Any] = {
            "scale_source": self.scale_source,
            "lens": self.lens,
            "gel_thickness_mm": self.gel_thickness_mm,
            "crosstalk": None if self.crosstalk is None else self.crosstalk.describe(),
        }
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
