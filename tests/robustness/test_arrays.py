"""Every public function, with each of its arguments replaced by something odd in turn, and with all of them odd."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gelform
from hostile.budget import SLOW_IF_ALL, cases
from hostile.damage import ODD_VALUES, odd_arrays
from hostile.doors import ALL_ODD, DEEPER, DOORS, RECORDS, SETTINGS
from hostile.outcome import judge

pytestmark = SLOW_IF_ALL

SLOW = ("picture", "calibrate", "evaluate", "scale_from_stage")
EXPORTS = DEEPER | {name: getattr(gelform, name) for name in gelform.__all__ if not name.endswith("Error")}
NOTHING_RIGHT = (
    *ODD_VALUES,
    float("nan"),
    1e9,
    (1, 2),
    (1.0, 2.0, 3.0),
    gelform.View(),
    *odd_arrays(np.ones((6, 8, 3), np.float32)),
)


def test_every_export_is_tried():
    """A new one needs a line in hostile/doors.py: what is right for it, or why nothing is."""
    assert set(EXPORTS) == {*DOORS, *SETTINGS, *RECORDS, *ALL_ODD}


@pytest.mark.parametrize("name", [name for name in EXPORTS if name not in RECORDS])
def test_all_arguments_odd(name, tmp_path, monkeypatch):
    """Of its signature, so that nobody has to write down what a function takes."""
    monkeypatch.chdir(tmp_path)
    function = EXPORTS[name]
    parameters = inspect.signature(function).parameters.values()
    named = [(p.name, p.default is p.empty) for p in parameters if p.name != "progress"]

    @cases(10)
    @given(data=st.data())
    def of_any_kind(data):
        given_ones = [one for one, needed in named if needed or data.draw(st.booleans())]
        chosen = {one: data.draw(st.integers(0, len(NOTHING_RIGHT) - 1)) for one in given_ones}
        judge(f"{name}({chosen})", lambda: function(**{one: NOTHING_RIGHT[k] for one, k in chosen.items()}))

    of_any_kind()


def as_numbers(value: Any) -> np.ndarray | None:
    """The numbers that something holds, or None: same numbers in other clothes have to give the same result."""
    try:
        array = np.ma.getdata(value) if isinstance(value, np.ma.MaskedArray) else np.asarray(value)
        return None if np.ma.isMaskedArray(value) or array.dtype.kind not in "fiub" else array.astype(float)
    except (TypeError, ValueError, RuntimeError):
        return None


def values_of(result: Any) -> list[np.ndarray]:
    """The arrays of a result, for comparison."""
    if isinstance(result, np.ndarray):
        return [result]
    if isinstance(result, tuple):
        return [array for one in result for array in values_of(one)]
    return [value for value in getattr(result, "__dict__", {}).values() if isinstance(value, np.ndarray)]


def difference(door: str, got: Any, argument: str, odd: Any) -> str | None:
    """Where the odd argument holds the right numbers, the result has to be the right one."""
    function, arguments = DOORS[door]
    right, numbers = as_numbers(arguments[argument]), as_numbers(odd)
    if right is None or numbers is None or right.shape != numbers.shape or not np.allclose(right, numbers):
        return None
    for one, other in zip(values_of(got), values_of(function(**arguments))):
        if not one.size and one.shape == other.shape:
            continue
        if one.shape != other.shape or not np.allclose(one, other, atol=2e-2 * max(1.0, np.abs(other).max())):
            return "the same numbers give another result"
    return None


@pytest.mark.parametrize("door", DOORS)
def test_odd_arguments(door):
    function, arguments = DOORS[door]
    with np.errstate(all="ignore"):
        odd = {
            name: odd_arrays(value) if isinstance(value, np.ndarray) else list(ODD_VALUES)
            for name, value in arguments.items()
        }

    @cases(4 if door in SLOW else 25)
    @given(argument=st.sampled_from(sorted(arguments)), which=st.integers(0, 80))
    def of_any_kind(argument, which):
        chosen = odd[argument][which % len(odd[argument])]
        judge(
            f"{door}({argument}=odd {which % len(odd[argument])})",
            lambda: function(**{**arguments, argument: chosen}),
            lambda got: difference(door, got, argument, chosen),
        )

    of_any_kind()


@pytest.mark.parametrize("door", SETTINGS)
def test_odd_settings(door):
    function, names = SETTINGS[door]

    @cases(50)
    @given(name=st.sampled_from(names), which=st.integers(0, len(ODD_VALUES) + 2))
    def of_any_kind(name, which):
        odd = (*ODD_VALUES, 1e9, 3e38, float("nan"))[which]
        judge(f"{door}({name}={odd!r:.30})", lambda: function(**{name: odd}))

    of_any_kind()
