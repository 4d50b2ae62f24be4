"""The tensors in the pickle of `torch.save` as arrays: nothing of a file is called, and nothing is as large as it states."""

from __future__ import annotations

import io
import pickle
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

# A bfloat16 has no dtype here: its bytes stay bytes, which are no weights.
_DTYPES = {
    "DoubleStorage": "<f8",
    "FloatStorage": "<f4",
    "HalfStorage": "<f2",
    "BFloat16Storage": "<u2",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
    "ShortStorage": "<i2",
    "CharStorage": "i1",
    "ByteStorage": "u1",
    "BoolStorage": "?",
}
# All that a state dict needs: numbers, texts, tuples, lists, dicts, names and storages. Each takes time and memory in
# proportion to its bytes. Sets, objects, and dicts made at once are left out: they hash or call what a file made.
_OPCODES = (
    "PROTO", "STOP", "MARK", "POP", "BINPUT", "LONG_BINPUT", "MEMOIZE", "BINGET", "LONG_BINGET",
    "NONE", "NEWTRUE", "NEWFALSE", "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "BINUNICODE", "SHORT_BINUNICODE",
    "EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_LIST", "APPEND", "APPENDS", "EMPTY_DICT",
    "GLOBAL", "STACK_GLOBAL", "REDUCE", "BINPERSID",
)  # fmt: skip


def _no_dict_of(*given: Any) -> dict[Any, Any]:
    if given:
        raise pickle.UnpicklingError("an OrderedDict with contents")
    return {}


def _tensor(storage: NDArray[Any], start: int, shape: Any, strides: Any, *_: Any) -> NDArray[Any]:
    """A view of a storage; UnpicklingError if it is larger than the storage."""
    counts = [start, *shape, *strides]
    if len(shape) != len(strides) or not all(type(one) is int and 0 <= one <= storage.size for one in counts):
        raise pickle.UnpicklingError(f"a tensor {shape} in {storage.size} numbers")
    last = start + sum((n - 1) * stride for n, stride in zip(shape, strides))
    if last >= storage.size or len(shape) > 8:
        raise pickle.UnpicklingError(f"a tensor {shape} in {storage.size} numbers")
    bytes_apart = [stride * storage.itemsize for stride in strides]
    return np.lib.stride_tricks.as_strided(storage[start:], shape, bytes_apart, writeable=False)


_NAMES: dict[tuple[str, str], Any] = {
    ("collections", "OrderedDict"): _no_dict_of,
    ("torch._utils", "_rebuild_tensor_v2"): _tensor,
    ("torch._utils", "_rebuild_parameter"): lambda tensor, *_: tensor,
    **{("torch", name): dtype for name, dtype in _DTYPES.items()},
}


class TensorReader(pickle._Unpickler):
    """Reads one pickle.

    Parameters
    ----------
    content : of the member `data.pkl`
    stored : bytes of each storage by its name

    Raises
    ------
    pickle.UnpicklingError
        On `load`: a name or an operation that no state dict needs, or a tensor larger than its storage.
    """

    stack: list[Any]  # of pickle, untyped
    pop_mark: Any

    def __init__(self, content: bytes, stored: Mapping[str, bytes]) -> None:
        super().__init__(io.BytesIO(content))
        self._stored = stored

    def find_class(self, module: str, name: str, /) -> Any:
        """What stands for a name of the pickle."""
        if (module, name) not in _NAMES:
            raise pickle.UnpicklingError(f"the name {module}.{name}")
        return _NAMES[module, name]

    def persistent_load(self, pid: Any, /) -> NDArray[Any]:
        """The numbers of a storage, as many as there are."""
        _, dtype, name, *_ = pid
        return np.frombuffer(self._stored[name], dtype)

    def _refuse(self) -> None:
        raise pickle.UnpicklingError("an operation that no state dict needs")

    def _set_items(self) -> None:
        """Fill a dict; its keys are names or numbers, because other keys may take for ever to hash."""
        items = self.pop_mark()
        self._fill(items)

    def _set_item(self) -> None:
        value, key = self.stack.pop(), self.stack.pop()
        self._fill([key, value])

    def _fill(self, items: list[Any]) -> None:
        if not isinstance(self.stack[-1], dict) or not all(isinstance(key, (str, int)) for key in items[::2]):
            raise pickle.UnpicklingError("a dict with keys that are no names")
        self.stack[-1].update(zip(items[::2], items[1::2]))

    def _build(self) -> None:
        """Leave out an object's state: of an OrderedDict, the versions of torch's modules."""
        self.stack.pop()

    dispatch: ClassVar[dict[int, Any]] = {
        **dict.fromkeys(range(256), _refuse),
        **{
            getattr(pickle, name)[0]: pickle._Unpickler.dispatch[getattr(pickle, name)[0]]
            for name in _OPCODES
        },
        pickle.SETITEMS[0]: _set_items,
        pickle.SETITEM[0]: _set_item,
        pickle.BUILD[0]: _build,
    }
