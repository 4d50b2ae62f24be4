"""Names in the help are those of the tables, though the tables are not imported for it."""

import pytest

from gelform.cli import tables


def test_the_names_are_those_of_the_tables():
    from gelform.color_models import COLOR_MODELS
    from gelform.importers.calibrations import PACKAGES
    from gelform.sensors.profiles import SENSORS
    from gelform.simulate import LAYOUTS

    assert tuple(COLOR_MODELS) == tables.COLOR_MODELS
    assert tuple(PACKAGES) == tables.PACKAGES
    assert tuple(SENSORS) == tables.SENSORS
    assert tuple(LAYOUTS) == tables.LAYOUTS
    assert [sensor.name for sensor in LAYOUTS.values()] == list(LAYOUTS)


def test_the_help_names_them_all(run):
    for command, names in (("calibrate", tables.COLOR_MODELS), ("import", tables.PACKAGES)):
        said = " ".join(run(command, "--help")[1].split())
        assert tables.listed(names) in said.replace("auto, ", "")


def test_a_table_that_is_none_is_said():
    with pytest.raises(LookupError, match="Expected a dict THEM"):
        tables.names_in("color_models/__init__.py", "THEM")
    with pytest.raises(LookupError, match="keys written out"):
        tables.names_in("color_models/__init__.py", "__all__")


def test_names_as_a_sentence_has_them():
    assert [tables.listed(names) for names in (("a",), ("a", "b"), ("a", "b", "c"))] == [
        "a",
        "a or b",
        "a, b or c",
    ]
