"""A network of another package, trained on raw images: its input is colors and place, and slopes at rest are subtracted.

It needs the image itself, which the color change and the background give: image = background + 255 change
(a calibration with such a network subtracts, and does not blur).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from gelform.image.view.resample import pixel_positions
from gelform.slopes.color_models._shared.layers import Layers, RestedNetwork
from gelform.slopes.color_models.lambertian import MAX_SLOPE
from gelform.slopes.color_models.seam import Stored, check_image_shape

Position = Literal["xy", "yx", "zeros"]
Answer = Literal["angles", "normals"]


@dataclass(frozen=True)
class NetworkModel(Stored):
    """An imported network with the inputs (B, G, R)/255 and place, and two outputs.

    Attributes
    ----------
    layers : five inputs, two outputs
    background : (H, W, 3) float32, 0-255, the background image that it was imported with
    position : "xy" for x/W, y/H after the colors, "yx" for y/H, x/W, "zeros" for two zeros
    answer : "angles" are slope angles in rad of a surface that is lower where pressed; "normals" are n_x, n_y
    """

    layers: Layers
    background: NDArray[np.float32]
    position: Position
    answer: Answer

    name: ClassVar[str] = "network"
    change_offset: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        self.layers.check_reads_slopes()
        if self.position not in ("xy", "yx", "zeros") or self.answer not in ("angles", "normals"):
            raise ValueError(
                f"Expected position as xy, yx or zeros and answer as angles or normals, got {self.position!r} "
                f"and {self.answer!r}."
            )

    def gradients_at(
        self, color_change: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Gradients (N, 2) of scattered pixels over the background that it was imported with."""
        rows, columns = (np.asarray(v).astype(int) for v in (y_px, x_px))
        prepared = self._prepared(self.background[rows, columns], np.asarray(x_px), np.asarray(y_px))
        return prepared.gradients_from_color(np.asarray(color_change, dtype=np.float32))[0].astype(np.float64)

    def prepare(self, background: NDArray[Any], shape: tuple[int, int]) -> PreparedNetwork:
        """Prepare the inputs at rest, and the network's output for them, for frames of the imported size."""
        height, width = self.background.shape[:2]
        check_image_shape(shape, (height, width), made="imported")
        rest = np.asarray(background, dtype=np.float32).reshape(-1, 3)
        return self._prepared(rest, *pixel_positions(shape).T)

    def _prepared(self, rest: NDArray[Any], x: NDArray[Any], y: NDArray[Any]) -> PreparedNetwork:
        height, width = self.background.shape[:2]
        inputs = np.zeros((5, len(x)), dtype=np.float32)
        inputs[:3] = rest[:, ::-1].T / np.float32(255)
        if self.position != "zeros":
            place = x / width, y / height
            inputs[3:] = place if self.position == "xy" else place[::-1]
        network = RestedNetwork(self.layers, inputs, (2, 1, 0), np.ones(3))
        return PreparedNetwork(network, self.answer, len(x))


class PreparedNetwork:
    """The network with its output at rest. It is immutable; threads can share it."""

    def __init__(self, network: RestedNetwork, answer: Answer, pixels: int) -> None:
        self._network, self._answer = network, answer
        self._rest = np.float32(0)
        self._rest = self._slopes(np.zeros((pixels, 3), dtype=np.float32))

    def gradients_from_color(self, color_change: NDArray[np.float32]) -> tuple[NDArray[np.float32], None]:
        """Gradients (..., 2) of a color change (..., 3), (I - I0)/255; their deviation is unknown."""
        slopes = self._slopes(color_change.reshape(-1, 3))
        return slopes.reshape(*color_change.shape[:-1], 2), None

    def _slopes(self, change: NDArray[np.float32]) -> Any:
        answer = self._network.outputs_from_color(change)
        if self._answer == "angles":
            return -np.tan(answer) - self._rest
        square = np.sum(answer**2, axis=-1, keepdims=True)
        down = np.sqrt(np.maximum(1 - square, square / MAX_SLOPE**2))  # the network may give |n| >= 1
        return -answer / np.maximum(down, np.float32(1e-12)) - self._rest
