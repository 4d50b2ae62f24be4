"""Whole files: what is no file, too large or unreadable is named before anything is read."""

import os
import sys

import pytest

from gelform.errors import CalibrationError, DataError
from gelform.foundations.whole_files import bytes_of, present_file


def test_a_file_of_the_largest_size_is_read_and_a_larger_one_is_not(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(bytes(range(100)))
    assert bytes_of(path, "numbers", 100) == bytes(range(100))
    assert present_file(path, "numbers") == path
    with pytest.raises(
        CalibrationError, match=r"Expected numbers of at most 9\.9e-05 MB, got .*a\.bin of 0\.0001 MB"
    ):
        bytes_of(path, "numbers", 99, CalibrationError)


def test_what_is_no_file_is_named(tmp_path):
    with pytest.raises(DataError, match="got the folder"):
        bytes_of(tmp_path, "numbers", 100)
    with pytest.raises(DataError, match=r"No file .*none: expected numbers"):
        bytes_of(tmp_path / "none", "numbers", 100)


@pytest.mark.skipif(sys.platform == "win32", reason="no pipes with a name")
def test_pipes_and_links_to_themselves_are_named(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(DataError, match="a pipe or a device"):
        bytes_of(tmp_path / "pipe", "numbers", 100)
    (tmp_path / "link").symlink_to(tmp_path / "link")
    with pytest.raises(DataError, match=r"Cannot read .*link: Too many levels"):
        bytes_of(tmp_path / "link", "numbers", 100)
