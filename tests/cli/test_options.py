"""Option values are checked when parsed, groups are flat on the command line, names are those of the tables."""

from typing import Annotated, Optional

import pytest
import typer

from gelform.cli import options
from gelform.cli.options import as_written, numbers, one_of, positive


def test_numbers_are_read_and_others_refused():
    assert positive("1e-2") == 0.01
    assert numbers("1,2.5,-3", "A,B,C", "--x") == (1, 2.5, -3)
    for text in ("0", "-1", "nan", "inf", "six", "", "1,2"):
        with pytest.raises(typer.BadParameter, match=r"expected a number > 0, got"):
            positive(text)
    for text in ("1,2", "1,2,3,4", "1,b,3", "", "1,nan,3"):
        with pytest.raises(typer.BadParameter, match="expected A,B,C, got"):
            numbers(text, "A,B,C", "--x")


def test_a_name_has_to_be_known():
    assert one_of("a", ("a", "b"), "--x") == "a"
    with pytest.raises(typer.BadParameter, match="expected a or b, got 'c'"):
        one_of("c", ("a", "b"), "--x")


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--mm-per-px", "15.8", "up to 1 mm, got 15.8. If these are pixels per mm, give 1/15.8 = 0.06329."),
        ("--mm-per-px", "px", "expected a number > 0, got 'px'"),
        ("--mm-per-px", "1e-6", "at least 0.0001 mm, got 1e-06. Is it in mm?"),
        ("--ball-diameter-mm", "300", "up to 200 mm, got 300."),
        ("--ball-diameter-mm", "6,35", "got '6,35'. Write it with a decimal point: 6.35."),
    ],
)
def test_a_number_that_no_sensor_or_ball_has_is_said(fails, press_folder, tmp_path, option, value, message):
    for command, file in (("calibrate", "-o"), ("evaluate", "-c")):
        said = fails(command, press_folder, file, tmp_path / "c.npz", option, value, status=2)
        assert option in said
        assert message in said


def test_the_names_are_those_of_the_tables():
    from gelform.calibration.starters import starter_names
    from gelform.exchange.importers.calibrations import PACKAGES
    from gelform.sensors.profiles import SENSORS
    from gelform.simulate import LAYOUTS
    from gelform.slopes.color_models import COLOR_MODELS

    assert tuple(starter_names()) == options.STARTERS
    assert tuple(COLOR_MODELS) == options.COLOR_MODELS
    assert tuple(PACKAGES) == options.PACKAGES
    assert tuple(SENSORS) == options.SENSORS
    assert tuple(LAYOUTS) == options.LAYOUTS
    assert [sensor.name for sensor in LAYOUTS.values()] == list(LAYOUTS)


def test_the_help_names_them_all_as_a_sentence(run):
    assert [options.listed(tuple(names)) for names in ("a", "ab", "abc")] == ["a", "a or b", "a, b or c"]
    for command, names in (("calibrate", options.COLOR_MODELS), ("import", options.PACKAGES)):
        said = " ".join(run(command, "--help")[1].split())
        assert options.listed(names) in said.replace("auto, ", "")


def test_a_table_that_is_none_is_said():
    with pytest.raises(LookupError, match="Expected a dict THEM"):
        options.names_in("slopes/color_models/__init__.py", "THEM")
    with pytest.raises(LookupError, match="keys written out"):
        options.names_in("slopes/color_models/__init__.py", "__all__")


def test_an_options_names_are_found_on_python_3_10():
    """Its `get_type_hints` puts an Optional around an annotation whose default is None."""
    written = Annotated[int | None, typer.Option("-c")]
    assert as_written(written) == written
    assert as_written(Optional[written]) == written  # noqa: UP045 (as Python 3.10 does)
    assert as_written(int | None) == int | None
