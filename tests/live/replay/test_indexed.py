"""Recordings by number: every frame is the one that was recorded, in whatever order it is asked for."""

import numpy as np
import pytest

import gelform
from gelform.errors import DataError
from gelform.live.replay.indexed import indexed, is_recording

ORDER = (0, 4, 3, 6, 1, 1, 5, 2)


@pytest.mark.parametrize("form", ["mcap", "recorded", "images", "video"])
def test_any_frame_in_any_order(form, forms, frames):
    recording = indexed(forms[form])
    assert len(recording) == len(frames)
    for number in ORDER:
        found = recording.frame(number)
        np.testing.assert_array_equal(found.image, frames[number].image)
        assert found.time_s == pytest.approx(recording.times_s[number])


@pytest.mark.parametrize(("form", "rate_hz"), [("mcap", 20), ("recorded", 20), ("video", 20), ("images", 25)])
def test_times_are_those_of_the_recording(form, rate_hz, forms, frames):
    times = indexed(forms[form]).times_s
    np.testing.assert_allclose(times, np.arange(len(frames)) / rate_hz, atol=1e-3)


@pytest.mark.parametrize("form", ["mcap", "recorded"])
def test_the_camera_is_known(form, forms):
    recording = indexed(forms[form])
    assert (recording.name, recording.serial, dict(recording.settings)) == ("ring", "S7", {"exposure": 50.0})


@pytest.mark.parametrize("form", ["mcap", "recorded", "images", "video"])
def test_numbers_are_those_of_open_source(form, forms):
    """What the page's code says: the n-th frame of the source."""
    with gelform.open_source(forms[form]) as source:
        played = list(source)
    recording = indexed(forms[form])
    for number in (0, 3, 6):
        np.testing.assert_array_equal(recording.frame(number).image, played[number].image)


def test_what_is_no_recording_is_said(tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "empty").mkdir()
    for name, words in (("notes.txt", "no video"), ("empty", "Expected images")):
        with pytest.raises(DataError, match=words):
            indexed(tmp_path / name)
    assert is_recording(str(tmp_path / "empty"))
    assert not is_recording("/dev/null")
    assert not is_recording("2BKRXXXX")


def test_an_image_that_was_removed_meanwhile_is_said(forms, tmp_path):
    import shutil

    copied = shutil.copytree(forms["recorded"], tmp_path / "copy")
    recording = indexed(copied)
    (copied / "00000003.png").unlink()
    with pytest.raises(DataError, match=r"00000003\.png"):
        recording.frame(3)
