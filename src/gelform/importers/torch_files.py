"""Tensors from a `.pth` or `.pt` file, without torch and without running code from the file.

Such a file is a zip: `data.pkl` describes the tensors; `data/0`, `data/1` ... contain their numbers. The pickle is not
unpickled. A stack machine follows the few instructions that a dict of tensors needs, and refuses all others.
"""

from __future__ import annotations

import pickletools
import zipfile
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError, said
from gelform.foundations.npz_files import DAMAGED_ARCHIVE, present_file

MAX_BYTES, MAX_PICKLE_BYTES = 64 * 2**20, 2**20  # limits of the file, and of the description of its tensors

_STORAGES = {
    "FloatStorage": "f4",
    "DoubleStorage": "f8",
    "HalfStorage": "f2",
    "LongStorage": "i8",
    "IntStorage": "i4",
}
_TENSOR = "torch._utils _rebuild_tensor_v2"
_DICT = "collections OrderedDict"
_INERT = {_TENSOR, _DICT, *(f"torch {name}" for name in _STORAGES)}
_MARK = object()


@dataclass(frozen=True)
class _Name:
    """A class or function that the pickle names; never imported."""

    name: str


@dataclass(frozen=True)
class _Storage:
    """Numbers kept in the member `data/<key>`."""

    dtype: str
    key: str


@dataclass(frozen=True)
class _Tensor:
    storage: _Storage
    offset: int
    size: tuple[int, ...]
    stride: tuple[int, ...]


def read_tensors(path: str | PathLike[str]) -> dict[str, NDArray[Any]]:
    """The tensors of a state dict by name, such as "fc1.weight"; in nested dicts "state_dict.fc1.weight".

    DataError: the file is missing, an old torch file that is no zip, or damaged; it holds more than tensors in dicts
    (such as a pickled module, which could run code); or it declares more than 64 MB.
    """
    path = present_file(path, "weights saved by torch (.pth, .pt)")
    try:
        with zipfile.ZipFile(path) as archive:
            return _tensors(archive, path)
    except zipfile.BadZipFile as problem:
        raise DataError(_not_a_zip(path)) from problem
    except (OSError, *DAMAGED_ARCHIVE) as problem:
        raise DataError(f"{path} is truncated or damaged: {said(problem)}. Copy it again.") from problem


def _not_a_zip(path: Path) -> str:
    with open(path, "rb") as file:
        start = file.read(2)
    if start[:1] == b"\x80":
        return (
            f"{path} is a pickle, as torch wrote before version 1.6: reading it could run code, so gelform does "
            "not. If you trust it, save it again where torch is installed: "
            "torch.save(torch.load(old, weights_only=True), new)."
        )
    return f"{path} is truncated or damaged, or not written by torch.save. Copy it again from its source."


def _tensors(archive: zipfile.ZipFile, path: Path) -> dict[str, NDArray[Any]]:
    declared = sum(member.file_size for member in archive.infolist())
    if declared > MAX_BYTES:
        raise DataError(
            f"{path} declares {declared / 1e6:.3g} MB; networks that gelform reads have at most "
            f"{MAX_BYTES >> 20} MB. It is damaged or another network."
        )
    pickles = [name for name in archive.namelist() if name.split("/")[1:] == ["data.pkl"]]
    if len(pickles) != 1:
        raise DataError(f"Expected a file of torch.save with one data.pkl in it, got {path}.")
    if archive.getinfo(pickles[0]).file_size > MAX_PICKLE_BYTES:
        raise DataError(f"{path} describes its tensors in more than 1 MB. It is damaged or another network.")
    folder = pickles[0].removesuffix("data.pkl")
    order = archive.read(f"{folder}byteorder") if f"{folder}byteorder" in archive.namelist() else b"little"
    if order.strip() != b"little":
        raise DataError(f"Expected little-endian numbers in {path}, got {order!r}.")
    try:
        content = _followed(archive.read(pickles[0]))
        return _named(content, archive, folder)
    except DataError as problem:
        raise DataError(f"{path}: {problem}") from None
    except (ValueError, IndexError, KeyError, TypeError, AttributeError, RecursionError) as problem:
        raise DataError(
            f"{path} is damaged: its description of tensors makes no sense ({said(problem)})."
        ) from problem


def _followed(pickled: bytes) -> Any:
    """The dicts, lists, tuples, numbers, texts and tensors that a pickle describes; everything else is refused."""
    stack: list[Any] = []
    memo: dict[int, Any] = {}
    for opcode, found, _ in pickletools.genops(pickled):
        name, argument = opcode.name, cast(Any, found)
        if name in _CONSTANTS:
            stack.append(_CONSTANTS[name]())
        elif name in _LITERALS:
            stack.append(argument)
        elif name in ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"):
            memo[len(memo) if argument is None else argument] = stack[-1]
        elif name in ("GET", "BINGET", "LONG_BINGET"):
            stack.append(memo[argument])
        elif name == "STOP":
            return stack.pop()
        elif name not in ("PROTO", "FRAME"):
            _act(name, argument, stack)
    raise ValueError("it has no end")


_CONSTANTS: dict[str, Any] = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_DICT": dict,
    "EMPTY_LIST": list,
    "EMPTY_TUPLE": tuple,
    "MARK": lambda: _MARK,
}
_LITERALS = {"BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "BINUNICODE", "SHORT_BINUNICODE"}


def _act(name: str, argument: Any, stack: list[Any]) -> None:
    """Run one instruction that works on the stack."""
    if name == "GLOBAL":
        stack.append(_inert(argument))
    elif name == "STACK_GLOBAL":
        attribute, module = stack.pop(), stack.pop()
        stack.append(_inert(f"{module} {attribute}"))
    elif name == "TUPLE":
        stack.append(tuple(_to_mark(stack)))
    elif name in ("TUPLE1", "TUPLE2", "TUPLE3"):
        count = int(name[-1])
        stack[-count:] = [tuple(stack[-count:])]
    elif name == "BINPERSID":
        stack.append(_storage(stack.pop()))
    elif name == "REDUCE":
        arguments = stack.pop()
        stack.append(_made(stack.pop(), arguments))
    elif name in ("SETITEM", "SETITEMS"):
        items = _last_two(stack) if name == "SETITEM" else _to_mark(stack)
        _checked(stack[-1], dict).update(zip(items[::2], items[1::2], strict=True))
    elif name in ("APPEND", "APPENDS"):
        items = [stack.pop()] if name == "APPEND" else _to_mark(stack)
        _checked(stack[-1], list).extend(items)
    elif name == "BUILD":  # an OrderedDict's own attributes: versions of modules
        _checked(stack.pop(), dict)
        _checked(stack[-1], dict)
    else:
        raise DataError(f"its pickle holds the instruction {name}, which no dict of tensors needs: refused.")


def _inert(name: str) -> _Name:
    if name not in _INERT:
        raise DataError(
            f"its pickle names {name.replace(' ', '.')}: this is no plain dict of tensors but a pickled object, "
            "and reading it could run code. If you trust it, load it with its own package and save its weights "
            "alone: torch.save(model.state_dict(), new)."
        )
    return _Name(name)


def _checked(value: Any, kind: type) -> Any:
    if not isinstance(value, kind):
        raise TypeError(f"{kind.__name__} expected, {type(value).__name__} found")
    return value


def _to_mark(stack: list[Any]) -> list[Any]:
    start = max(k for k, value in enumerate(stack) if value is _MARK)
    items = stack[start + 1 :]
    del stack[start:]
    return items


def _last_two(stack: list[Any]) -> list[Any]:
    items = stack[-2:]
    del stack[-2:]
    return items


def _storage(described: Any) -> _Storage:
    kind, name, key, _, _ = described
    if kind != "storage" or not isinstance(name, _Name) or not isinstance(key, str):
        raise ValueError(f"a storage of {kind!r}")
    return _Storage(_STORAGES[name.name.removeprefix("torch ")], key)


def _made(function: Any, arguments: tuple[Any, ...]) -> Any:
    name = _checked(function, _Name).name
    if name == _DICT:
        return dict(*arguments)
    if name != _TENSOR:
        raise ValueError(f"{name} called")
    storage, offset, size, stride = arguments[:4]
    return _Tensor(_checked(storage, _Storage), int(offset), tuple(map(int, size)), tuple(map(int, stride)))


def _named(content: Any, archive: zipfile.ZipFile, folder: str, prefix: str = "") -> dict[str, NDArray[Any]]:
    """Every tensor below, by its path in the dicts; other values (an epoch, a setting) are skipped."""
    found: dict[str, NDArray[Any]] = {}
    for key, value in _checked(content, dict).items():
        if isinstance(value, dict):
            found |= _named(value, archive, folder, f"{prefix}{key}.")
        elif isinstance(value, _Tensor):
            found[f"{prefix}{key}"] = _array(value, archive.read(f"{folder}data/{value.storage.key}"))
    return found


def _array(tensor: _Tensor, content: bytes) -> NDArray[Any]:
    """The numbers of a tensor: a view into its storage, checked against the storage's size, copied."""
    numbers = np.frombuffer(content, dtype="<" + tensor.storage.dtype)
    steps = [(size - 1) * stride for size, stride in zip(tensor.size, tensor.stride, strict=True)]
    count = int(np.prod(tensor.size, dtype=object))
    inside = min((tensor.offset, *tensor.size, *tensor.stride)) >= 0 and (
        count == 0 or tensor.offset + sum(steps) < numbers.size
    )
    if not inside or count > MAX_BYTES // 4:
        raise ValueError(f"a tensor of shape {tensor.size} in {numbers.size} numbers")
    strides = tuple(numbers.itemsize * stride for stride in tensor.stride)
    view = np.lib.stride_tricks.as_strided(
        numbers[min(tensor.offset, numbers.size) :], tensor.size, strides, writeable=False
    )
    return view.copy()
