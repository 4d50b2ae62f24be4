"""Damage to bytes and to values, drawn by hypothesis, which retries smaller cases after a failure."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st

PLACE = st.floats(0, 1)
OPERATIONS = ("flip", "set", "cut", "drop", "insert", "repeat", "zero", "shuffle")


@st.composite
def byte_damages(draw: Any) -> list[tuple[str, float, int]]:
    """One to three damages: an operation, a place 0-1, a number 0-255."""
    return draw(
        st.lists(st.tuples(st.sampled_from(OPERATIONS), PLACE, st.integers(0, 255)), min_size=1, max_size=3)
    )


def damaged(content: bytes, damages: list[tuple[str, float, int]]) -> bytes:
    """The content with damages done to it one after the other."""
    for operation, place, number in damages:
        content = _damaged(bytearray(content), operation, place, number)
    return content


def _damaged(content: bytearray, operation: str, place: float, number: int) -> bytes:
    if not content:
        return bytes(content)
    at = min(int(place * len(content)), len(content) - 1)
    span = slice(at, at + 1 + number)
    if operation == "flip":
        content[at] ^= 1 << (number % 8)
    elif operation == "set":
        content[at] = number
    elif operation == "cut":
        del content[at:]
    elif operation == "drop":
        del content[span]
    elif operation == "insert":
        content[at:at] = bytes([number]) * (1 + number % 17)
    elif operation == "repeat":
        content[at:at] = content[span]
    elif operation == "zero":
        content[span] = bytes(len(content[span]))
    else:
        content[span] = content[span][::-1]
    return bytes(content)


def _deep(levels: int) -> Any:
    value: Any = 1
    for _ in range(levels):
        value = [value]
    return value


# What no setting is: types, ranges and sizes.
ODD_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, 10**30, 0.0, -0.5, 1e-300, 1e300, 0.5, "", "0.1", "nan", "x" * 300,
    "\x00", "../../etc", [], [1], [1, 2], [1, 2, 3], [[1, 2], [3]], [None], {}, {"a": 1}, _deep(60),
)  # fmt: skip


def odd_arrays(array: np.ndarray) -> list[Any]:
    """What may come instead of an array: of other types, shapes, values; and the same values in other clothes."""
    like = np.asarray(array)
    numbers = like.astype(np.float64) if like.dtype.kind in "fiub" else np.ones(like.shape)
    bad = numbers.copy()
    bad.flat[:1] = np.nan
    endless = numbers.copy()
    endless.flat[-1:] = -np.inf
    turned, axes = np.ascontiguousarray(like.T), np.atleast_1d(like)
    same = [
        numbers.astype(">f8"), numbers.astype(np.longdouble), like.tolist(), np.asfortranarray(like), _read_only(like),
        np.repeat(like, 2, axis=0)[::2] if like.ndim else like, like.astype(like.dtype.newbyteorder(">")),
    ]  # fmt: skip
    other = [
        None, "text", b"bytes", 3, 2.5, [], {}, object(), [[1, 2], [3]], [[1, "a"], [2, "b"]], np.float64(np.nan), bad,
        endless, numbers * 1e300, numbers * 1e-300, -numbers, numbers + 1j, numbers.astype(object), like.astype(str),
        like.astype("M8[s]") if like.dtype.kind in "iu" else np.zeros(like.shape, "M8[s]"), like[..., None], like[None],
        axes[..., :0], axes[:0], like.ravel(), turned, np.zeros(like.shape, dtype=[("a", "f4")]), axes[..., :1],
        np.full(like.shape, 3e38, np.float32), np.full(like.shape, 1e-42, np.float32), np.zeros(like.shape, np.float32),
        numbers.astype(np.float16), numbers.astype(np.int64), (numbers > 0), numbers.astype(np.uint16), [like, like],
        np.ma.masked_array(like, mask=like > like.flat[0] if like.size else False), axes[1:],
        like[:, 1:] if like.ndim > 1 else 0,
        numbers.astype(np.int8), iter(like.tolist() if like.ndim else []), lambda: like,
    ]  # fmt: skip
    return same + other


def _read_only(array: np.ndarray) -> np.ndarray:
    copy = array.copy()
    copy.setflags(write=False)
    return copy
