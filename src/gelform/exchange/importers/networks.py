"""Networks of other packages, from their weights: gs_sdk, gsrobotics and its browser port."""

from __future__ import annotations

import pickletools
import re
from collections import Counter
from collections.abc import Mapping
from itertools import pairwise
from os import PathLike
from pathlib import Path
from pickle import UnpicklingError
from typing import Any
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError, needed, said
from gelform.foundations.npz_files import DAMAGED_ARCHIVE
from gelform.foundations.whole_files import present_file
from gelform.slopes.color_models import NetworkModel
from gelform.slopes.color_models._shared.layers import Layers

WEB_SIZES = (5, 64, 64, 64, 2)  # of the layers of gsrobotics' browser port
LAYERS = 4  # of each package's network
UNITS = {"gs_sdk": (32, 128), "gsrobotics": (64,)}  # of the first layer; 128 in gs_sdk's older networks
# All that a pickle of weights names; and how it writes the size of a storage.
_NAMES = re.compile(
    r"collections OrderedDict|torch\._utils _rebuild_(tensor_v2|parameter)|torch [A-Z][A-Za-z0-9]*Storage"
)
_NUMBERS = ("BININT", "BININT1", "BININT2", "LONG1")
MAX_BYTES = 4 * 2**20  # of all members of a file: 100 times these networks


def read_gs_sdk(path: str | PathLike[str], background: NDArray[np.float32]) -> NetworkModel:
    """gs_sdk's `nnmodel.pth`: B, G, R, x/W, y/H to slope angles of a surface that goes down where pressed.

    Its older networks, 1x1 convolutions of 5-128-32-32-2 with BatchNorm, become layers of the same output.
    """
    return NetworkModel(_layers(path, "gs_sdk"), background, "xy", "angles")


def read_gsrobotics(
    path: str | PathLike[str], background: NDArray[np.float32], *, position: str
) -> NetworkModel:
    """gsrobotics' `nnmini.pt`: B, G, R, row/H, column/W to normals n_x, n_y.

    Parameters
    ----------
    position : "zeros" as in the original program, which truncates the positions, or "true"
    """
    return NetworkModel(_layers(path, "gsrobotics"), background, _position(position), "normals")


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


def _layers(path: str | PathLike[str], package: str) -> Layers:
    """fc1 ... fc4 or conv1 ... conv4 of a file; their width distinguishes the two packages' networks."""
    tensors = _state_dict(present_file(path, "weights saved by torch (.pth, .pt)"))
    kind = "conv" if "conv1.weight" in tensors else "fc"
    wanted = [f"{kind}{k}.{part}" for k in range(1, LAYERS + 1) for part in ("weight", "bias")]
    missing = [name for name in wanted if name not in tensors]
    if missing:
        raise DataError(
            f"Expected the layers {kind}1 to {kind}{LAYERS} in {path}, got {', '.join(list(tensors)[:6]) or 'none'}. "
            "Is it of another package?"
        )
    width = tuple(tensors[wanted[0]].shape[:1])
    if width not in [(units,) for units in UNITS[package]]:
        other = next((f": is it {name}'s?" for name, sizes in UNITS.items() if {*width} & {*sizes}), ".")
        sizes = " or ".join(map(str, UNITS[package]))
        raise DataError(f"Expected hidden layers of {sizes} units in {path}, got {width}{other}")
    weights, biases = zip(*(_folded(tensors, kind, k, path) for k in range(1, LAYERS + 1)))
    return _of_file(path, weights, biases)


def _folded(tensors: Mapping[str, Any], kind: str, k: int, path: str | PathLike[str]) -> tuple[Any, Any]:
    """Weight and bias of layer `k`, with the BatchNorm after it: y = (Wx + b - mean) gain/sqrt(variance + eps) + shift."""
    weight, bias = (_array(tensors, f"{kind}{k}.{part}", path) for part in ("weight", "bias"))
    if weight.ndim == 4 and weight.shape[2:] == (1, 1):
        weight = weight[:, :, 0, 0]
    if weight.ndim != 2:
        raise DataError(
            f"{path} holds a network that looks at neighbors of a pixel (weights {weight.shape}), such as py3DCal's "
            "TouchNet, which gelform does not run. Calibrate again from its presses: gelform calibrate."
        )
    if f"bn{k}.running_var" in tensors:
        names = ("weight", "bias", "running_mean", "running_var")
        gain, shift, mean, variance = (_array(tensors, f"bn{k}.{name}", path) for name in names)
        if any(one.shape != bias.shape for one in (gain, shift, mean, variance)) or not (variance >= 0).all():
            raise DataError(f"Expected a BatchNorm of {bias.shape} units after layer {k} in {path}.")
        gain = gain / np.sqrt(variance + 1e-5)  # torch's BatchNorm, as gs_sdk uses it
        weight, bias = weight * gain[:, None], (bias - mean) * gain + shift
    return weight.astype(np.float32), bias.astype(np.float32)


def _array(tensors: Mapping[str, Any], name: str, path: str | PathLike[str]) -> NDArray[np.float64]:
    if name not in tensors or tensors[name].nbytes > MAX_BYTES:  # a view may repeat its numbers
        raise DataError(f"{path} lacks {name}, or it is of another size.")
    return np.asarray(tensors[name].double().numpy())


def _state_dict(path: Path) -> dict[str, Any]:
    """The tensors of a file of `torch.save`, by name; no code in it runs.

    Only what `torch.save` has written since version 1.6, a zip: for older files the guard `weights_only` has a hole
    before torch 2.6 (CVE-2025-32434). Programs of TorchScript have the member `constants.pkl`.
    """
    with open(path, "rb") as file:
        start = file.read(4)
    if start[:1] == b"\x80":
        raise DataError(
            f"{path} is a pickle, as torch wrote before version 1.6: reading it could run code, so gelform does "
            "not. If you trust it, save it again where torch is installed: "
            "torch.save(torch.load(old, weights_only=True), new)."
        )
    try:
        with ZipFile(path) as archive:
            members = Counter(name.split("/")[-1] for name in archive.namelist())
            declared = sum(member.file_size for member in archive.infolist())
            pickles = [name for name in archive.namelist() if name.split("/")[-1] == "data.pkl"]
            pickled = archive.read(pickles[0]) if len(pickles) == 1 and declared <= MAX_BYTES else b""
    except (OSError, *DAMAGED_ARCHIVE) as problem:
        raise DataError(f"{path} is truncated or damaged: {said(problem)}. Copy it again.") from problem
    if start != b"PK\x03\x04" or members["data.pkl"] != 1 or members["constants.pkl"]:
        raise DataError(f"Expected weights of torch.save, a zip with data.pkl in it, got {path}.")
    if declared > MAX_BYTES:
        raise DataError(
            f"{path} declares {declared / 1e6:.3g} MB; networks that gelform reads have at most "
            f"{MAX_BYTES >> 20} MB. It is damaged or another network."
        )
    try:
        _check_pickle(pickled)
        torch = needed("torch", "torch", "A network saved by torch")
        content = torch.load(path, map_location="cpu", weights_only=True)
    except UnpicklingError as problem:
        raise DataError(
            f"{path} holds more than tensors in dicts, such as a pickled module, or is damaged. Reading it could run "
            "code. If you trust it, load it with its own package and save its weights alone: "
            "torch.save(model.state_dict(), new)."
        ) from problem
    except DataError:
        raise
    except Exception as problem:  # torch names no classes for what is damaged
        raise DataError(f"{path} is truncated or damaged: {said(problem)}. Copy it again.") from problem
    content = content.get("state_dict", content) if isinstance(content, dict) else None
    kept = content.items() if isinstance(content, dict) else ()
    return {str(name): one.detach() for name, one in kept if isinstance(one, torch.Tensor) and _is_plain(one)}


def _check_pickle(content: bytes) -> None:
    """Refuse (UnpicklingError) what takes more time or memory than its length; ValueError if it is no pickle.

    torch makes storages as large as they say, and `weights_only` lets a pickle repeat what it holds, which doubles it with
    each line.
    """
    said: list[tuple[str, Any]] = []  # the operations so far, without those that only remember
    kinds: dict[Any, str] = {}  # of what is remembered
    numbers = 0
    for operation, argument, _ in pickletools.genops(content):
        name = operation.name
        if name.endswith("BINPUT"):
            kinds[argument] = said[-1][0]
            continue
        if name.endswith("BINGET") and kinds.get(argument, "") not in ("GLOBAL", "BINUNICODE"):
            raise UnpicklingError("something repeated")
        if name == "GLOBAL" and not _NAMES.fullmatch(str(argument)):
            raise UnpicklingError(f"the name {argument}")
        if name == "BINPERSID":
            (of_count, count), (of_storage, _) = said[-2:]
            numbers += count if of_count in _NUMBERS and of_storage == "TUPLE" else MAX_BYTES + 1
        if not 0 <= numbers <= MAX_BYTES:
            raise UnpicklingError("a storage larger than the file")
        said.append((name, argument))


def _is_plain(tensor: Any) -> bool:
    """Whether it holds floats one by one: not sparse, and not a mere shape."""
    return bool(
        tensor.is_floating_point() and str(tensor.layout) == "torch.strided" and tensor.device.type == "cpu"
    )


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
