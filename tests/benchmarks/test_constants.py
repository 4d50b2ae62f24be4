"""The script that tries each chosen number changes that number alone, and its page has the constants of the code."""

from __future__ import annotations

import re

import pytest

from constants.chosen import (
    PACKAGE,
    Number,
    _Loader,
    all_numbers,
    changed_c,
    is_chosen,
    is_reached,
    numbers_of,
    numbers_of_c,
    uses_of,
)
from constants.figures import PARTS, parts_of
from constants.page import PAGE, code, outcome, page, unit_of

NAMED = [number for number in all_numbers() if number.name]
SOURCE = '''
"""A module."""

# px, of nine sensors
WIDE_PX, NARROW_PX = 12.5, 0.25
TURNS = 7


def f(x, y=0.3):
    return x[5] * 1.5 + 2 * TURNS
'''


@pytest.fixture
def made(tmp_path, monkeypatch):
    """A module of a package, and its numbers by name or line."""
    monkeypatch.setattr("constants.chosen.PACKAGE", tmp_path)
    path = tmp_path / "one.py"
    path.write_text(SOURCE, encoding="utf-8")
    return path, {number.name or number.value: number for number in numbers_of(path)}


def test_numbers_are_those_that_somebody_chose(made):
    _, found = made
    assert list(found) == ["WIDE_PX, NARROW_PX", "TURNS", "def f(x, y=0.3):", "return x[5] * 1.5 + 2 * TURNS"]
    assert [len(number.literals) for number in found.values()] == [1, 1, 1, 1]
    assert found["WIDE_PX, NARROW_PX"].says == "px, of nine sensors"
    assert not any(map(is_chosen, (0, 2, 1e-6, 0.5, 256, True, "7")))


@pytest.mark.parametrize(
    ("key", "factor", "changed"),
    [
        ("TURNS", 1.2, {"TURNS": 8}),
        ("TURNS", 1 / 1.2, {"TURNS": 6}),
        ("WIDE_PX, NARROW_PX", 1.2, {"WIDE_PX": 15.0}),
        ("def f(x, y=0.3):", 2.0, {"y": 0.6}),
        ("return x[5] * 1.5 + 2 * TURNS", 2.0, {"result": 10 * 3 + 14}),
    ],
)
def test_a_trial_changes_one_number(made, key, factor, changed):
    path, found = made
    names = {}
    exec(_Loader("one", str(path), found[key], factor).get_code("one"), names)
    seen = {name: names[name] for name in ("WIDE_PX", "NARROW_PX", "TURNS")}
    seen |= {"y": names["f"].__defaults__[0], "result": names["f"]([10] * 6)}
    usual = {"WIDE_PX": 12.5, "NARROW_PX": 0.25, "TURNS": 7, "y": 0.3, "result": 29.0}
    if "TURNS" in changed:
        usual["result"] = 15 + 2 * changed["TURNS"]
    assert seen == usual | changed


def test_a_constant_is_reached_where_it_is_used_or_what_follows_from_it():
    number = next(one for one in NAMED if one.name == "FINEST_PX")
    assert not any("FINEST_PX" in line for line in _lines(number, uses_of("FINEST_PX")))
    assert is_reached(number, uses_of("BLURS_PX"))
    assert not is_reached(number, [(number.path, 1)])


def _lines(number: Number, places):
    text = (PACKAGE / number.path).read_text(encoding="utf-8").splitlines()
    return [text[at - 1] for path, at in places if path == number.path]


@pytest.mark.parametrize("number", NAMED, ids=lambda one: f"{one.path} {one.name}")
def test_each_constant_says_where_it_comes_from(number):
    assert re.search(r"\w{2}", number.says), (
        f"{number.path}: say of {number.name} what it is, its unit and its source"
    )


def test_the_page_has_the_constants_of_the_code():
    assert _constants(PAGE.read_text(encoding="utf-8")) == _constants(page(all_numbers(), {})), (
        "run python benchmarks/constants.py --page"
    )


def _constants(text):
    """File, name and value of each row of a constant."""
    rows = (re.split(r"(?<!\\) \| ", line) for line in text.splitlines() if line.count(" | ") >= 5)
    return sorted((row[0], row[1], row[3]) for row in rows if row[1].startswith("`"))


def test_a_row_counts_for_its_value_alone():
    number = next(one for one in NAMED if one.name == "FINEST_PX")

    def said(parts, value=number.value):
        return outcome(number, {number.key: {"value": value, "parts": parts}})

    everywhere = dict.fromkeys(PARTS, "nothing")
    assert said(everywhere) == "nothing"
    assert said(everywhere, "3.0") == "not tried"
    assert said({"light": "nothing"}) == "not tried on all"
    assert said(dict.fromkeys(parts_of(number.room), "nothing")) == "nothing"
    assert {"motion", "light"} < set(parts_of("native/motion"))
    assert "motion" not in parts_of("image")
    assert said({"light": "nothing", "dots": None, "frames": "depth +2.0 %"}) == "frames: depth +2.0 %"
    assert said(dict.fromkeys(PARTS)) == "not reached"
    assert unit_of(number) == "px"
    assert code("a | b") == "`a \\| b`"


def test_a_trial_changes_one_number_of_c(tmp_path, monkeypatch):
    monkeypatch.setattr("constants.chosen.ROOT", tmp_path)
    path = tmp_path / "one.c"
    path.write_text(
        "/* 7.5 */ float a[12] = {0}; // 9.5\nfloat b = 0.3f * x[7] + 12; /* 5\n6 */\n", encoding="utf-8"
    )
    [number] = numbers_of_c(path)
    assert number.value == "float b = 0.3f * x[7] + 12;"
    changed = changed_c(number, 2.0)
    assert changed == path.read_text(encoding="utf-8").replace("0.3f", "0.6f").replace("+ 12", "+ 24")
