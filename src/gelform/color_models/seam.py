"""The seam that every color model fits: what it learns from and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Samples:
    """Pixels whose gradient is known.

    Attributes
    ----------
    color_change : (N, 3) float32
    x_px, y_px : (N,) float32, pixel positions
    gradients : (N, 2) float64, mm/mm
    weight : (N,) float64, >= 0
    shape : (H, W) of the images they come from
    background : (H, W, 3) float32, the untouched image, for models that learn from the light at a place; or None
    """

    color_change: NDArray[Any]
    x_px: NDArray[Any]
    y_px: NDArray[Any]
    gradients: NDArray[Any]
    weight: NDArray[Any]
    shape: tuple[int, int]
    background: NDArray[Any] | None = None


class PreparedColorModel(Protocol):
    """A color model ready for frames of one shape over one background."""

    def gradients_from_color(
        self, color_change: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Gradients (H, W, 2) of a color change (H, W, 3), and their standard deviation or None."""
        ...


class ColorModel(Protocol):
    """A fitted color model; immutable.

    Beside these methods its class has `fit(samples, **settings)`, the settings being the model's own, and
    `from_arrays(arrays, settings)`, which rebuilds what `to_arrays` gave.
    """

    name: ClassVar[str]
    change_offset: ClassVar[float]

    def gradients_at(
        self, color_change: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Gradients (N, 2) of scattered pixels."""
        ...

    def prepare(self, background: NDArray[Any], shape: tuple[int, int]) -> PreparedColorModel:
        """Everything that does not depend on the frame, computed once."""
        ...

    def to_arrays(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Arrays and JSON-able settings that `from_arrays` rebuilds the model from."""
        ...
