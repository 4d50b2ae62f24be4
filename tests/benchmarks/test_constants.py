"""The benchmark of tuned constants changes the stated values, records which are read, and measures movement in noise."""

import importlib
import sys

import pytest

from constants.changed import SOURCE, ChangedModule, Constant, Executed, constants, lines_with
from gelform import foundations
from gelform.depth.contact import contact_from_depth, pressure


def test_constants_are_found_with_their_values():
    found = {one.label: one.value for one in constants()}
    assert found["depth/contact/pressure.py FINER"] == pressure.FINER
    assert found["depth/contact/pressure.py MIN_AREA_MM2"] == pressure.MIN_AREA_MM2
    assert not any("BYTES" in label or label.startswith("live") for label in found)


@pytest.mark.parametrize(
    ("name", "factor", "value"), [("SIGMAS_OF_DEPTH", 2.0, 4.0), ("MIN_AREA_MM2", 0.5, 0.025)]
)
def test_a_constant_is_changed_in_its_text_alone(name, factor, value):
    (one,) = (c for c in constants() if c.label == f"depth/contact/pressure.py {name}")
    changed, text = one.changed(factor)
    space: dict = {}
    exec(compile(text, "contact", "exec"), space)
    assert changed == space[name] == value
    assert [k for k, v in vars(pressure).items() if isinstance(v, float) and space[k] != v] == [name]


def test_a_whole_number_stays_one_and_moves():
    assert [Constant("image/health.py", "ONE", 1, 0, 0, 1).changed(f)[0] for f in (2.0, 0.5)] == [2, 0]
    assert [Constant("image/health.py", "FIVE", 5, 0, 0, 1).changed(f)[0] for f in (2.0, 0.5)] == [10, 2]


def test_a_changed_module_is_what_everyone_imports(monkeypatch):
    text = (SOURCE / "foundations" / "filters.py").read_text().replace("LANES = 16", "LANES = 32")
    monkeypatch.setattr(sys, "meta_path", [ChangedModule("foundations/filters.py", text), *sys.meta_path])
    monkeypatch.setattr(foundations, "filters", foundations.filters)  # undone: what the import sets
    monkeypatch.delitem(sys.modules, "gelform.foundations.filters")
    changed = importlib.import_module("gelform.foundations.filters")
    monkeypatch.undo()
    assert (changed.LANES, foundations.filters.LANES) == (32, 16)


def test_what_is_read_is_noticed():
    executed = Executed(lines_with(constants()))
    executed.start()
    with pytest.raises(ValueError, match="of one frame"):
        contact_from_depth([[[0.0]]], mm_per_px=1.0)
    sys.settrace(None)
    assert not executed.labels
    executed.start()
    contact_from_depth([[0.0] * 9] * 9, mm_per_px=1.0)
    sys.settrace(None)
    assert {
        "depth/contact/pressure.py LEAST_NOISE",
        "depth/contact/pressure.py FRACTION_AT_REST",
    } <= executed.labels
