"""Training of the `mlp` color model; needs torch, the extra `torch`. Nothing else imports it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.errors import needed
from gelform.slopes.color_models._shared.layers import Layers
from gelform.slopes.color_models._shared.least_squares import HUBER_SLOPE

BATCH, LEARNING_RATE = 512, 1e-2  # samples of a step; learning rate of AdamW


def train(
    change: NDArray[Any],
    place: NDArray[Any],
    gradients: NDArray[Any],
    weight: NDArray[Any],
    *,
    hidden: tuple[int, ...],
    steps: int,
    weight_decay: float,
    seed: int,
) -> Layers:
    """Layers whose output for (change, place) minus that for (0, place) is the gradient, in Huber's loss.

    It uses AdamW with a cosine schedule (Loshchilov and Hutter, ICLR 2019) and one thread; all randomness comes from
    `seed`. The N samples have a color change (N, 3) about 1 in size, a place (N, 2) of -1 to 1, gradients (N, 2) and
    weights (N,) >= 0.
    """
    torch = needed("torch", "torch", "Training the color model mlp")
    if not hidden or steps < 1 or len(change) < 2:
        raise ValueError(f"Expected hidden layers, steps and samples, got {hidden}, {steps}, {len(change)}.")
    with _one_thread(torch):
        random = torch.Generator().manual_seed(seed)
        touched, rest, target, relative = _tensors(torch, change, place, gradients, weight)
        layers = _initial(torch, (touched.shape[1], *hidden, 2), random)
        optimizer = torch.optim.AdamW(
            [p for pair in layers for p in pair], lr=LEARNING_RATE, weight_decay=weight_decay
        )
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
        for _ in range(steps):
            rows = torch.randint(len(touched), (min(BATCH, len(touched)),), generator=random)
            answers = _forward(torch, layers, torch.cat([touched[rows], rest[rows]]))
            residual = torch.linalg.norm(answers[: len(rows)] - answers[len(rows) :] - target[rows], dim=1)
            loss = (relative[rows] * _huber(torch, residual)).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
        weights, biases = zip(*[[p.detach().numpy().copy() for p in pair] for pair in layers])
    return Layers(weights, biases)


@contextmanager
def _one_thread(torch: Any) -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _tensors(
    torch: Any, change: NDArray[Any], place: NDArray[Any], gradients: NDArray[Any], weight: NDArray[Any]
) -> tuple[Any, Any, Any, Any]:
    """Inputs under touch, inputs at rest, targets, and weights of mean 1."""
    touched = np.concatenate([change, place], axis=1)
    rest = np.concatenate([np.zeros_like(change), place], axis=1)
    relative = np.asarray(weight) / max(float(np.mean(weight)), 1e-12)
    touched, rest, target, relative = (
        torch.from_numpy(np.ascontiguousarray(a, dtype=np.float32))
        for a in (touched, rest, gradients, relative)
    )
    return touched, rest, target, relative


def _initial(torch: Any, sizes: tuple[int, ...], random: Any) -> list[tuple[Any, Any]]:
    """Weights by He's rule (ICCV 2015), with biases that spread the kinks over the inputs' range."""
    layers = []
    for inputs, outputs in pairwise(sizes):
        weight = torch.randn((outputs, inputs), generator=random) * (2 / inputs) ** 0.5
        bias = (torch.rand((outputs,), generator=random) - 0.5) * (outputs > 2)
        layers.append((weight.requires_grad_(), bias.requires_grad_()))
    return layers


def _forward(torch: Any, layers: list[tuple[Any, Any]], values: Any) -> Any:
    for k, (weight, bias) in enumerate(layers):
        values = torch.nn.functional.linear(values, weight, bias)
        values = torch.relu(values) if k + 1 < len(layers) else values
    return values


def _huber(torch: Any, residual: Any) -> Any:
    """Huber's loss of the residual's length, in units of its threshold."""
    r = residual / HUBER_SLOPE
    return torch.where(r < 1, 0.5 * r**2, r - 0.5)
