"""The list of recordings: names that are made here, and no way past it."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform.errors import GelformError
from gelform.live.replay.recordings import Recordings


def test_given_and_found_ones_are_listed_once(forms):
    listed = Recordings([forms["mcap"], forms["images"]], forms["mcap"].parent)
    names = [one["name"] for one in listed.facts()]
    assert names == ["a.mcap", "d", "b", "c.avi"]
    assert listed.path("a.mcap") == forms["mcap"]
    assert listed.facts()[0]["bytes"] == forms["mcap"].stat().st_size
    assert listed.facts()[1]["bytes"] is None


def test_two_of_one_name_are_told_apart(forms, tmp_path):
    copy = tmp_path / "a.mcap"
    copy.write_bytes(b"")
    listed = Recordings([forms["mcap"], copy])
    assert listed.path("a.mcap (2)") == copy


def test_folders_are_not_fetched_and_what_is_gone_is_said(forms, tmp_path):
    gone = tmp_path / "gone.mcap"
    gone.write_bytes(b"x")
    listed = Recordings([forms["recorded"], gone])
    gone.unlink()
    for number in (0, 1, 2, -1):
        with pytest.raises(GelformError, match="Share"):
            listed.file(number)
    assert listed.facts()[1]["bytes"] is None


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(st.text(max_size=30) | st.sampled_from(["../a.mcap", "/etc/passwd", "a.mcap/..", "b/frames.csv"]))
def test_no_other_name_opens_anything(forms, name):
    listed = Recordings([forms["mcap"]])
    if name != "a.mcap":
        with pytest.raises(GelformError, match="no recording"):
            listed.path(name)
