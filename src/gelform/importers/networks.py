"""Networks of other packages, from their weights: gs_sdk, gsrobotics and its browser port."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.color_models import NetworkModel
from gelform.color_models._shared.layers import Layers
from gelform.errors import DataError
from gelform.foundations.npz_files import present_file
from gelform.importers.torch_files import read_tensors

WEB_SIZES = (5, 64, 64, 64, 2)  # of the layers of gsrobotics' browser port
LAYERS = 4  # of each package's network
UNITS = {"gs_sdk": 32, "gsrobotics": 64}


def read_gs_sdk(path: str | PathLike[str], background: NDArray[np.float32]) -> NetworkModel:
    """gs_sdk's `nnmodel.pth`: B, G, R, x/W, y/H to slope angles of a surface that goes down where pressed."""
    return NetworkModel(_layers(read_tensors(path), path, UNITS["gs_sdk"]), background, "xy", "angles")


def read_gsrobotics(
    path: str | PathLike[str], background: NDArray[np.float32], *, position: str
) -> NetworkModel:
    """gsrobotics' `nnmini.pt`: B, G, R, row/H, column/W to normals n_x, n_y.

    Parameters
    ----------
    position : "zeros" as in the original program, which truncates the positions, or "true"
    """
    tensors = {name.removeprefix("state_dict."): a for name, a in read_tensors(path).items()}
    return NetworkModel(
        _layers(tensors, path, UNITS["gsrobotics"]), background, _position(position), "normals"
    )


def read_gsrobotics_web(
    path: str | PathLike[str], background: NDArray[np.float32], *, position: str
) -> NetworkModel:
    """The browser port's weights: 8834 little-endian float32, W1 (64, 5) by rows, b1, ... W4 (2, 64), b4."""
    wanted = sum(n_in * n_out + n_out for n_in, n_out in pairwise(WEB_SIZES))
    path = present_file(path, f"{wanted} numbers, little-endian float32")
    if path.stat().st_size != 4 * wanted:
        raise DataError(
            f"Expected {4 * wanted} bytes ({wanted} numbers, little-endian float32), got {path} of "
            f"{path.stat().st_size}. Is it the browser port's file of weights?"
        )
    numbers = np.fromfile(path, dtype="<f4")
    weights, biases, start = [], [], 0
    for n_in, n_out in pairwise(WEB_SIZES):
        weights.append(numbers[start : start + n_in * n_out].reshape(n_out, n_in))
        biases.append(numbers[start + n_in * n_out : start + n_in * n_out + n_out])
        start += n_in * n_out + n_out
    return NetworkModel(
        _of_file(path, tuple(weights), tuple(biases)), background, _position(position), "normals"
    )


def _position(position: str) -> Any:
    if position not in ("zeros", "true"):
        raise ValueError(f"Expected position as 'zeros' or 'true', got {position!r}.")
    return "zeros" if position == "zeros" else "yx"


def _layers(tensors: Mapping[str, NDArray[Any]], path: str | PathLike[str], units: int) -> Layers:
    """fc1 ... fc4 of a state dict; their width distinguishes the two packages' networks."""
    if any(name.split(".")[-2:-1] == ["conv1"] for name in tensors):
        raise DataError(
            f"{path} holds a convolutional network (py3DCal's TouchNet has such layers: 298 GMAC a frame), which "
            "gelform does not run. Its data folder is what gelform can use: calibrate again from the presses."
        )
    wanted = [f"fc{k}.{kind}" for k in range(1, LAYERS + 1) for kind in ("weight", "bias")]
    missing = [name for name in wanted if name not in tensors]
    if missing:
        raise DataError(
            f"Expected the layers fc1 to fc{LAYERS} in {path}, got {', '.join(list(tensors)[:6]) or 'none'}. "
            "Is it of another package?"
        )
    width = tensors["fc1.weight"].shape[:1]
    if width != (units,):
        other = next((f": is it {name}'s?" for name, size in UNITS.items() if width == (size,)), ".")
        raise DataError(f"Expected hidden layers of {units} units in {path}, got {width}{other}")
    arrays = [np.asarray(tensors[name], dtype=np.float32) for name in wanted]
    return _of_file(path, tuple(arrays[::2]), tuple(arrays[1::2]))


def _of_file(path: str | PathLike[str], weights: tuple[Any, ...], biases: tuple[Any, ...]) -> Layers:
    try:
        layers = Layers(weights, biases)
    except ValueError as problem:
        raise DataError(f"{path}: {problem}") from problem
    if (layers.inputs, layers.outputs) != (5, 2):
        raise DataError(
            f"Expected a network of 5 inputs and 2 outputs in {path}, got {layers.inputs} and {layers.outputs}."
        )
    return layers
