"""A small fully connected network, run over all pixels: the engine of `mlp` and of imported networks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

BLOCK_PX = 8192  # pixels at a time; the units of a layer stay in the processor's cache


def blocks_of(count: int, each_px: int = 1) -> Iterator[slice]:
    """Slices of `count` rows of `each_px` pixels, some 8000 pixels each.

    >>> list(blocks_of(5, each_px=4096))
    [slice(0, 2, None), slice(2, 4, None), slice(4, 5, None)]
    """
    rows = max(1, BLOCK_PX // each_px)
    for start in range(0, count, rows):
        yield slice(start, min(start + rows, count))


MAX_UNITS, MAX_LAYERS = 4096, 16  # largest numbers in a file


@dataclass(frozen=True)
class Layers:
    """Weights of a fully connected network with ReLU between its layers.

    Attributes
    ----------
    weights : layers times (outputs, inputs) float32
    biases : layers times (outputs,) float32
    """

    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]

    def __post_init__(self) -> None:
        if not 1 <= len(self.weights) == len(self.biases) <= MAX_LAYERS:
            raise ValueError(
                f"Expected 1-{MAX_LAYERS} layers with a bias each, got {len(self.weights)} and {len(self.biases)}."
            )
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases)):
            inputs = weight.shape[-1] if k == 0 else self.weights[k - 1].shape[0]
            if weight.ndim != 2 or weight.shape[1] != inputs or bias.shape != weight.shape[:1]:
                raise ValueError(
                    f"Expected layer {k + 1} to take {inputs} inputs and have a bias for each output, got "
                    f"weights {weight.shape} and biases {bias.shape}."
                )
            if max(weight.shape) > MAX_UNITS or not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise ValueError(f"Expected finite layers of at most {MAX_UNITS} units, got layer {k + 1}.")

    @property
    def inputs(self) -> int:
        """The number of inputs."""
        return int(self.weights[0].shape[1])

    @property
    def outputs(self) -> int:
        """The number of outputs."""
        return int(self.weights[-1].shape[0])

    def check_reads_slopes(self) -> None:
        """Raise a ValueError unless it makes two numbers from three colors and a place."""
        if (self.inputs, self.outputs) != (5, 2):
            raise ValueError(
                f"Expected a network of 5 inputs and 2 outputs, got {self.inputs} and {self.outputs}."
            )

    def outputs_from(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """The outputs (outputs, N) for inputs (inputs, N)."""
        last = len(self.weights) - 1
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases)):
            values = weight @ values
            values += bias[:, None]
            if k < last:
                np.maximum(values, 0, out=values)
        return values

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays `weight1`, `bias1`, `weight2` ... that `from_arrays` rebuilds the layers from."""
        numbered = enumerate(zip(self.weights, self.biases), start=1)
        return {f"{name}{k}": a for k, pair in numbered for name, a in zip(("weight", "bias"), pair)}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]]) -> Layers:
        """The layers from `to_arrays`; other arrays are ignored."""
        count = sum(name.startswith("weight") for name in arrays)
        pairs = [(arrays[f"weight{k}"], arrays[f"bias{k}"]) for k in range(1, count + 1)]
        return cls(*(tuple(np.asarray(a, dtype=np.float32) for a in each) for each in zip(*pairs)))


class RestedNetwork:
    """A network over pixels whose inputs are those at rest plus the color change; immutable.

    Parameters
    ----------
    layers : Layers of at least three inputs, the first three being colors
    rest : (inputs, N) float32, inputs of each pixel at rest
    channels : of the color change, for the first three inputs: (2, 1, 0) for B, G, R
    scale : (3,), of the color change in the inputs' units
    """

    def __init__(
        self, layers: Layers, rest: NDArray[np.float32], channels: tuple[int, int, int], scale: NDArray[Any]
    ) -> None:
        self._layers = layers
        self._rest = np.asarray(rest, dtype=np.float32)
        self._channels = np.array(channels)
        self._scale = np.asarray(scale, dtype=np.float32)

    def outputs_from_color(self, color_change: NDArray[np.float32]) -> NDArray[np.float32]:
        """The outputs (N, outputs) for the color change (N, 3) of each pixel."""
        out = np.empty((color_change.shape[0], self._layers.outputs), dtype=np.float32)
        for part in blocks_of(len(out)):
            values = self._rest[:, part].copy()
            values[:3] += (self._scale * color_change[part][:, self._channels]).T
            out[part] = self._layers.outputs_from(values).T
        return out
