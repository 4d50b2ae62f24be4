"""Networks as color models: their layers in numpy, those of other packages, and one trained here.

That of another package was trained on raw images: its input is colors and place. It needs the image itself, which the color
change and the background give: image = background + 255 change (a calibration with such a network subtracts, and does not
blur). The one trained here goes from color change and place to gradients.

The raw output for the color of rest at the same place is subtracted, in training too: no color change means no slope.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar, Literal

import numpy as np

from gelform.arrays import Array, Floats, Map, Numbers, Slopes
from gelform.errors import needed
from gelform.foundations.filters import CHANGE_OFFSET
from gelform.image.view import pixel_positions
from gelform.slopes.color_models.physical import MAX_SLOPE
from gelform.slopes.color_models.seam import (
    HUBER_SLOPE,
    Samples,
    Stored,
    Untuned,
    check_image_shape,
    unit_position,
)

INPUTS = 5  # color change and place
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
    """Weights of a fully connected network with ReLU between its layers."""

    weights: tuple[Floats, ...]  # layers times (outputs, inputs) float32
    biases: tuple[Floats, ...]  # layers times (outputs,) float32

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
        if (self.inputs, self.outputs) != (INPUTS, 2):
            raise ValueError(
                f"Expected a network of 5 inputs and 2 outputs, got {self.inputs} and {self.outputs}."
            )

    def outputs_from(self, values: Floats) -> Map:
        """The outputs (outputs, N) for inputs (inputs, N)."""
        last = len(self.weights) - 1
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases)):
            values = weight @ values
            values += bias[:, None]
            if k < last:
                np.maximum(values, 0, out=values)
        return values

    def to_arrays(self) -> dict[str, Array]:
        """Arrays `weight1`, `bias1`, `weight2` ... that `from_arrays` rebuilds the layers from."""
        numbered = enumerate(zip(self.weights, self.biases), start=1)
        return {f"{name}{k}": a for k, pair in numbered for name, a in zip(("weight", "bias"), pair)}

    @classmethod
    def from_arrays(cls, arrays: dict[str, Array]) -> Layers:
        """The layers from `to_arrays`; other arrays are ignored."""
        count = sum(name.startswith("weight") for name in arrays)
        pairs = [(arrays[f"weight{k}"], arrays[f"bias{k}"]) for k in range(1, count + 1)]
        return cls(*(tuple(np.asarray(a, dtype=np.float32) for a in each) for each in zip(*pairs)))


Position = Literal["xy", "yx", "zeros"]
Answer = Literal["angles", "normals"]


class PreparedNetwork:
    """A network over pixels whose inputs are those at rest plus the color change. It is immutable; threads can share it.

    `channels` of the color change are added to the first three inputs: (2, 1, 0) for B, G, R.
    """

    def __init__(
        self,
        layers: Layers,  # of at least three inputs, the first three being colors
        rest: Map,  # (inputs, N), inputs of each pixel at rest
        channels: tuple[int, int, int],
        scale: Array,  # (3,), of the color change in the inputs' units
        answer: Answer | None = None,  # None: slopes
    ) -> None:
        self._layers, self._answer = layers, answer
        self._inputs = np.asarray(rest, dtype=np.float32)
        self._channels, self._scale = np.array(channels), np.asarray(scale, dtype=np.float32)
        self._rest = np.float32(0)
        self._rest = self._slopes(np.zeros((rest.shape[1], 3), dtype=np.float32))

    def outputs_from_color(self, color_change: Map) -> Map:
        """The outputs (N, outputs) for the color change (N, 3) of each pixel."""
        out = np.empty((color_change.shape[0], self._layers.outputs), dtype=np.float32)
        for part in blocks_of(len(out)):
            values = self._inputs[:, part].copy()
            values[:3] += (self._scale * color_change[part][:, self._channels]).T
            out[part] = self._layers.outputs_from(values).T
        return out

    def gradients_from_color(self, color_change: Map) -> tuple[Slopes, None]:
        """Gradients (..., 2) of a color change (..., 3); their deviation is in the calibration, or unknown."""
        slopes = self._slopes(color_change.reshape(-1, 3))
        return slopes.reshape(*color_change.shape[:-1], 2), None

    def _slopes(self, change: Map) -> Any:
        answer = self.outputs_from_color(change)
        if self._answer == "angles":
            answer = -np.tan(answer)
        elif self._answer == "normals":
            square = np.sum(answer**2, axis=-1, keepdims=True)
            down = np.sqrt(np.maximum(1 - square, square / MAX_SLOPE**2))  # the network may give |n| >= 1
            answer = -answer / np.maximum(down, np.float32(1e-12))
        return answer - self._rest


@dataclass(frozen=True)
class NetworkModel(Stored):
    """An imported network with the inputs (B, G, R)/255 and place, and two outputs."""

    layers: Layers
    background: Map  # (H, W, 3), 0-255, the background image that it was imported with
    position: Position  # "xy" for x/W, y/H after the colors, "yx" for y/H, x/W, "zeros" for two zeros
    answer: Answer  # "angles", rad, of a surface that is lower where pressed; "normals" are n_x, n_y

    name: ClassVar[str] = "network"
    change_offset: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        self.layers.check_reads_slopes()
        if self.position not in ("xy", "yx", "zeros") or self.answer not in ("angles", "normals"):
            raise ValueError(
                f"Expected position as xy, yx or zeros and answer as angles or normals, got {self.position!r} "
                f"and {self.answer!r}."
            )

    def gradients_at(self, color_change: Array, x_px: Array, y_px: Array) -> Numbers:
        """Gradients (N, 2) of scattered pixels over the background that it was imported with."""
        rows, columns = (np.asarray(v).astype(int) for v in (y_px, x_px))
        prepared = self._prepared(self.background[rows, columns], np.asarray(x_px), np.asarray(y_px))
        return prepared.gradients_from_color(np.asarray(color_change, dtype=np.float32))[0].astype(np.float64)

    def prepare(self, background: Array, shape: tuple[int, int]) -> PreparedNetwork:
        """Prepare the inputs at rest, and the network's output for them, for frames of the imported size."""
        height, width = self.background.shape[:2]
        check_image_shape(shape, (height, width), made="imported")
        rest = np.asarray(background, dtype=np.float32).reshape(-1, 3)
        return self._prepared(rest, *pixel_positions(shape).T)

    def _prepared(self, rest: Array, x: Array, y: Array) -> PreparedNetwork:
        height, width = self.background.shape[:2]
        inputs = np.zeros((INPUTS, len(x)), dtype=np.float32)
        inputs[:3] = rest[:, ::-1].T / np.float32(255)
        if self.position != "zeros":
            place = x / width, y / height
            inputs[3:] = place if self.position == "xy" else place[::-1]
        return PreparedNetwork(self.layers, inputs, (2, 1, 0), np.ones(3), self.answer)


@dataclass(frozen=True)
class MlpModel(Stored, Untuned):
    """A network of five inputs (color change R, G, B in units of its size; x, y) and two slopes."""

    layers: Layers
    change_scale: Numbers  # (3,), divisor of the color change
    shape: tuple[int, int]  # (H, W) of the images it was fitted on

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

        The output for (change, place) minus that for (0, place) is the gradient, in Huber's loss. It uses AdamW with a
        cosine schedule (Loshchilov and Hutter, ICLR 2019) and one thread; all randomness comes from `seed`. GelformError:
        torch is not installed.
        """
        change = np.asarray(samples.color_change, dtype=np.float64)
        total = max(float(samples.weight.sum()), 1e-12)
        scale = np.sqrt(samples.weight @ change**2 / total) + 1e-6
        place = np.stack(unit_position(samples.x_px, samples.y_px, samples.shape), axis=-1)
        torch = needed("torch", "torch", "Training the color model mlp")
        if not hidden or steps < 1 or len(change) < 2:
            raise ValueError(
                f"Expected hidden layers, steps and samples, got {hidden}, {steps}, {len(change)}."
            )
        arrays = (
            np.concatenate([change / scale, place], axis=1),
            np.concatenate([np.zeros_like(change), place], axis=1),
            samples.gradients,
            np.asarray(samples.weight) / max(float(np.mean(samples.weight)), 1e-12),
        )
        tensors = [torch.from_numpy(np.ascontiguousarray(a, dtype=np.float32)) for a in arrays]
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            return cls(_trained(torch, tensors, hidden, steps, weight_decay, seed), scale, samples.shape)
        finally:
            torch.set_num_threads(threads)

    def gradients_at(self, color_change: Array, x_px: Array, y_px: Array) -> Numbers:
        """Gradients (N, 2) of scattered pixels."""
        prepared = self._prepared(np.asarray(x_px), np.asarray(y_px))
        return prepared.gradients_from_color(np.asarray(color_change, dtype=np.float32))[0].astype(np.float64)

    def prepare(self, background: Array, shape: tuple[int, int]) -> PreparedNetwork:
        """Prepare the inputs at rest of a frame, and the network's output for them."""
        check_image_shape(shape, self.shape)
        return self._prepared(*pixel_positions(shape).T)

    def _prepared(self, x_px: Array, y_px: Array) -> PreparedNetwork:
        inputs = np.zeros((INPUTS, len(x_px)), dtype=np.float32)
        inputs[3:] = unit_position(x_px, y_px, self.shape)
        return PreparedNetwork(self.layers, inputs, (0, 1, 2), 1 / self.change_scale)


def _trained(
    torch: Any, samples: list[Any], hidden: tuple[int, ...], steps: int, decay: float, seed: int
) -> Layers:
    """Layers for inputs under touch and at rest (N, 5), the difference of their outputs (N, 2), and weights of mean 1."""
    touched, rest, target, weight = samples
    random, layers = torch.Generator().manual_seed(seed), []
    # By He's rule (ICCV 2015), with biases that spread the kinks over the inputs' range.
    for inputs, outputs in pairwise((touched.shape[1], *hidden, 2)):
        matrix = torch.randn((outputs, inputs), generator=random) * (2 / inputs) ** 0.5
        bias = (torch.rand((outputs,), generator=random) - 0.5) * (outputs > 2)
        layers.append((matrix.requires_grad_(), bias.requires_grad_()))
    optimizer = torch.optim.AdamW([p for pair in layers for p in pair], lr=1e-2, weight_decay=decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        rows = torch.randint(len(touched), (min(512, len(touched)),), generator=random)
        values = torch.cat([touched[rows], rest[rows]])
        for k, (matrix, bias) in enumerate(layers):
            values = torch.nn.functional.linear(values, matrix, bias)
            values = torch.relu(values) if k + 1 < len(layers) else values
        residual = torch.linalg.norm(values[: len(rows)] - values[len(rows) :] - target[rows], dim=1)
        off = residual / HUBER_SLOPE
        loss = (weight[rows] * torch.where(off < 1, 0.5 * off**2, off - 0.5)).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    weights, biases = zip(*[[p.detach().numpy().copy() for p in pair] for pair in layers])
    return Layers(weights, biases)
