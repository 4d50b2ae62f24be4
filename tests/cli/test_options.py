"""Values of options are checked where they are read: a wrong one is a usage error that names the option."""

import pytest
import typer

from gelform.cli.options import numbers, one_of, positive


@pytest.mark.parametrize("text", ["0", "-1", "nan", "inf", "six", "", "1,2"])
def test_a_number_has_to_be_positive(text):
    with pytest.raises(typer.BadParameter, match=r"expected a number > 0, got"):
        positive(text)


def test_numbers_are_read():
    assert positive("1e-2") == 0.01
    assert numbers("1,2.5,-3", "A,B,C", "--x") == (1, 2.5, -3)


@pytest.mark.parametrize("text", ["1,2", "1,2,3,4", "1,b,3", "", "1,nan,3"])
def test_as_many_numbers_as_the_form_has(text):
    with pytest.raises(typer.BadParameter, match="expected A,B,C, got"):
        numbers(text, "A,B,C", "--x")


def test_a_name_has_to_be_known():
    assert one_of("a", ("a", "b"), "--x") == "a"
    with pytest.raises(typer.BadParameter, match="expected a or b, got 'c'"):
        one_of("c", ("a", "b"), "--x")


def test_the_option_is_named(fails, press_folder, tmp_path):
    for value in ("0", "nan", "px"):
        said = fails("calibrate", press_folder, "-o", tmp_path / "c.npz", "--mm-per-px", value, status=2)
        assert "--mm-per-px" in said
        assert f"'{value}'" in said
