"""A small network from color change and place to gradients, trained on presses; its output at rest is zero.

Its raw output for the color of rest at the same place is subtracted, in training too, so that no color change means
no slope.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gelform.foundations.filters import CHANGE_OFFSET
from gelform.image.view.resample import pixel_positions
from gelform.slopes.color_models._shared.layers import Layers, RestedNetwork
from gelform.slopes.color_models._shared.least_squares import unit_position
from gelform.slopes.color_models.seam import Samples, Stored, Untuned, check_image_shape


@dataclass(frozen=True)
class MlpModel(Stored, Untuned):
    """A network of five inputs (color change R, G, B in units of its size; x, y) and two slopes.

    Attributes
    ----------
    layers : five inputs, two outputs
    change_scale : (3,) float64, divisor of the color change
    shape : (H, W) of the images it was fitted on
    """

    layers: Layers
    change_scale: NDArray[np.float64]
    shape: tuple[int, int]

    name: ClassVar[str] = "mlp"
    change_offset: ClassVar[float] = CHANGE_OFFSET

    def __post_init__(self) -> None:
        self.layers.check_reads_slopes()

    @classmethod
    def fit(
        cls,
        samples: Samples,
        *,
        hidden: tuple[int, ...] = (32, 32),
        steps: int = 3000,
        weight_decay: float = 0.1,
        seed: int = 0,
    ) -> MlpModel:
        """Train on the samples, in seconds; the same samples, settings and torch give the same network.

        Raises
        ------
        GelformError
            torch is not installed: `pip install "gelform[torch]"`.
        """
        from gelform.slopes.color_models._shared.mlp_training import train

        change = np.asarray(samples.color_change, dtype=np.float64)
        total = max(float(samples.weight.sum()), 1e-12)
        scale = np.sqrt(samples.weight @ change**2 / total) + 1e-6
        place = np.stack(unit_position(samples.x_px, samples.y_px, samples.shape), axis=-1)
        settings: dict[str, Any] = {
            "hidden": hidden,
            "steps": steps,
            "weight_decay": weight_decay,
            "seed": seed,
        }
        layers = train(change / scale, place, samples.gradients, samples.weight, **settings)
        return cls(layers, scale, samples.shape)

    def gradients_at(
        self, color_change: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Gradients (N, 2) of scattered pixels."""
        prepared = PreparedMlp(self, np.asarray(x_px), np.asarray(y_px))
        return prepared.gradients_from_color(np.asarray(color_change, dtype=np.float32))[0].astype(np.float64)

    def prepare(self, background: NDArray[Any], shape: tuple[int, int]) -> PreparedMlp:
        """Prepare the inputs at rest of a frame, and the network's output for them."""
        check_image_shape(shape, self.shape)
        return PreparedMlp(self, *pixel_positions(shape).T)


class PreparedMlp:
    """The network with its output at rest at given places. It is immutable; threads can share it."""

    def __init__(self, model: MlpModel, x_px: NDArray[Any], y_px: NDArray[Any]) -> None:
        inputs = np.zeros((5, len(x_px)), dtype=np.float32)
        inputs[3:] = unit_position(x_px, y_px, model.shape)
        self._network = RestedNetwork(model.layers, inputs, (0, 1, 2), 1 / model.change_scale)
        self._rest = self._network.outputs_from_color(np.zeros((len(x_px), 3), dtype=np.float32))

    def gradients_from_color(self, color_change: NDArray[np.float32]) -> tuple[NDArray[np.float32], None]:
        """Gradients (..., 2) of a color change (..., 3); their deviation is in the calibration."""
        slopes = self._network.outputs_from_color(color_change.reshape(-1, 3)) - self._rest
        return slopes.reshape(*color_change.shape[:-1], 2), None
