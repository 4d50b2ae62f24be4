"""A small fully connected network, run over all pixels: the engine of `mlp` and of imported networks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

BLOCK = 320  # pixels at a time: the activations stay in cache
LANES = 4  # the kernel takes this many inputs and outputs at once
MAX_UNITS = 4096
MAX_LAYERS = 16


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
        """How many numbers go in."""
        return int(self.weights[0].shape[1])

    @property
    def outputs(self) -> int:
        """How many come out."""
        return int(self.weights[-1].shape[0])

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays `weight1`, `bias1`, `weight2` ... that `from_arrays` rebuilds the layers from."""
        numbered = enumerate(zip(self.weights, self.biases), start=1)
        return {f"{name}{k}": a for k, pair in numbered for name, a in zip(("weight", "bias"), pair)}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]]) -> Layers:
        """The layers of `to_arrays`; other arrays are left alone."""
        count = sum(name.startswith("weight") for name in arrays)
        pairs = [(arrays[f"weight{k}"], arrays[f"bias{k}"]) for k in range(1, count + 1)]
        return cls(*(tuple(np.asarray(a, dtype=np.float32) for a in each) for each in zip(*pairs)))


class RestedNetwork:
    """A network over pixels whose inputs are those at rest plus the colour change: immutable once made.

    Parameters
    ----------
    layers : Layers of at least three inputs, the first three being colours
    rest : (inputs, N) float32, what goes in for each pixel where nothing touches
    channels : of the color change, for the first three inputs: (2, 1, 0) for B, G, R
    scale : (3,), of the color change in the inputs' units
    """

    def __init__(
        self, layers: Layers, rest: NDArray[np.float32], channels: tuple[int, int, int], scale: NDArray[Any]
    ) -> None:
        self._sizes = np.array([_padded(layers.inputs), *(_padded(w.shape[0]) for w in layers.weights)])
        widest = int(self._sizes.max())
        self._weights = np.zeros((len(layers.weights), widest, widest), dtype=np.float32)
        self._biases = np.zeros((len(layers.weights), widest), dtype=np.float32)
        for k, (weight, bias) in enumerate(zip(layers.weights, layers.biases)):
            self._weights[k, : weight.shape[0], : weight.shape[1]] = weight
            self._biases[k, : bias.shape[0]] = bias
        self._outputs = layers.outputs
        self._rest = np.zeros((int(self._sizes[0]), rest.shape[1]), dtype=np.float32)
        self._rest[: layers.inputs] = rest
        self._channels = np.array(channels)
        self._scale = np.asarray(scale, dtype=np.float32)

    def outputs_from_color(self, color_change: NDArray[np.float32]) -> NDArray[np.float32]:
        """What comes out (N, outputs) for the color change (N, 3) of each pixel."""
        out = np.empty((color_change.shape[0], self._outputs), dtype=np.float32)
        change = np.ascontiguousarray(color_change, dtype=np.float32)
        _run(self._weights, self._biases, self._sizes, change, self._rest, self._channels, self._scale, out)
        return out


def _padded(units: int) -> int:
    return -(-units // LANES) * LANES


@njit(cache=True, fastmath=True, nogil=True)
def _run(weights, biases, sizes, change, rest, channels, scale, out):  # type: ignore[no-untyped-def]
    """Block by block: the inputs, then each layer from one buffer into the other."""
    count = change.shape[0]
    buffers = np.empty((2, weights.shape[1], BLOCK), np.float32)
    for start in range(0, count, BLOCK):
        size = min(BLOCK, count - start)
        now, last = buffers[0], weights.shape[0] - 1
        for i in range(sizes[0]):
            for k in range(size):
                now[i, k] = rest[i, start + k]
        for i in range(3):
            for k in range(size):
                now[i, k] += scale[i] * change[start + k, channels[i]]
        for layer in range(last + 1):
            now, then = buffers[(layer + 1) % 2], now
            _layer(
                weights[layer], biases[layer], then, now, sizes[layer], sizes[layer + 1], size, layer < last
            )
        for o in range(out.shape[1]):
            for k in range(size):
                out[start + k, o] = now[o, k]


@njit(cache=True, fastmath=True, nogil=True)
def _layer(w, b, x, out, inputs, outputs, size, relu):  # type: ignore[no-untyped-def]
    """out = relu(w x + b) of a block; four outputs and four inputs at a time keep the vector units busy."""
    zero = np.float32(0)
    for o in range(0, outputs, LANES):
        r0, r1, r2, r3 = out[o], out[o + 1], out[o + 2], out[o + 3]
        for k in range(size):
            r0[k], r1[k], r2[k], r3[k] = b[o], b[o + 1], b[o + 2], b[o + 3]
        for i in range(0, inputs, LANES):
            _add_four(w[o : o + 4, i : i + 4], x[i : i + 4], r0, r1, r2, r3, size)
        if relu:
            for k in range(size):
                r0[k], r1[k] = max(r0[k], zero), max(r1[k], zero)
                r2[k], r3[k] = max(r2[k], zero), max(r3[k], zero)


@njit(cache=True, fastmath=True, nogil=True)
def _add_four(w, x, r0, r1, r2, r3, size):  # type: ignore[no-untyped-def]
    """Four rows of outputs += w (4, 4) times four rows of inputs."""
    a0, a1, a2, a3 = w[0, 0], w[0, 1], w[0, 2], w[0, 3]
    b0, b1, b2, b3 = w[1, 0], w[1, 1], w[1, 2], w[1, 3]
    c0, c1, c2, c3 = w[2, 0], w[2, 1], w[2, 2], w[2, 3]
    d0, d1, d2, d3 = w[3, 0], w[3, 1], w[3, 2], w[3, 3]
    x0, x1, x2, x3 = x[0], x[1], x[2], x[3]
    for k in range(size):
        v0, v1, v2, v3 = x0[k], x1[k], x2[k], x3[k]
        r0[k] += a0 * v0 + a1 * v1 + a2 * v2 + a3 * v3
        r1[k] += b0 * v0 + b1 * v1 + b2 * v2 + b3 * v3
        r2[k] += c0 * v0 + c1 * v1 + c2 * v2 + c3 * v3
        r3[k] += d0 * v0 + d1 * v1 + d2 * v2 + d3 * v3
