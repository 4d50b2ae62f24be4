"""Objects of a kind, lists and paths: what is let in, and what is said to the rest."""

import numpy as np
import pytest

from gelform.checks import check_is, check_list, check_path
from gelform.view import View


@pytest.mark.parametrize("path", ["", "a\0b", "x" * 300, "a/" * 3000])
def test_paths_that_no_file_has(path):
    with pytest.raises(ValueError, match="which no file can be called"):
        check_path(path)


@pytest.mark.parametrize("path", [None, 3, b"x", ["x"]])
def test_what_is_no_path(path):
    with pytest.raises(TypeError, match="as text or a Path"):
        check_path(path)


def test_things_of_a_kind():
    view = View()
    assert check_is(view, View, "view") is view
    with pytest.raises(TypeError, match="Expected view as View, got NoneType"):
        check_is(None, View, "view")


def test_lists():
    assert check_list((1, 2), "images") == [1, 2]
    assert len(check_list(np.zeros((3, 2)), "images")) == 3
    with pytest.raises(TypeError, match="Expected each of names as str, got int"):
        check_list(["a", 1], "names", str)


@pytest.mark.parametrize("values", ["text", b"bytes", 3, None, np.array(1), {}, iter([1]), object()])
def test_what_is_no_list(values):
    with pytest.raises(TypeError, match="Expected images as a list, got"):
        check_list(values, "images")
