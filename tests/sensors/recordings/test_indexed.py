"""Recordings by number: every frame is the recorded one, in any order, in torn MCAP files too."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

import gelform
from gelform.errors import DataError
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.indexed import McapIndex, indexed, is_recording
from gelform.sensors.recordings.mcap_writer import McapRecording

ORDER = (0, 4, 3, 6, 1, 1, 5, 2)


@pytest.mark.parametrize("form", ["mcap", "images", "video"])
def test_any_frame_in_any_order_has_the_number_of_open_source(form, forms, frames):
    recording = indexed(forms[form])
    with gelform.open_source(forms[form]) as source:
        played = list(source)
    assert len(recording) == len(played) == len(frames)
    for number in ORDER:
        found = recording.frame(number)
        np.testing.assert_array_equal(found.image, frames[number].image)
        np.testing.assert_array_equal(found.image, played[number].image)
        assert found.time_s == pytest.approx(recording.times_s[number])


@pytest.mark.parametrize(("form", "rate_hz"), [("mcap", 20), ("video", 20), ("images", 25)])
def test_times_and_camera_are_those_of_the_recording(form, rate_hz, forms, frames):
    recording = indexed(forms[form])
    np.testing.assert_allclose(recording.times_s, np.arange(len(frames)) / rate_hz, atol=1e-3)
    if form == "mcap":
        facts = recording.facts
        assert (facts.name, facts.serial, dict(facts.settings)) == ("ring", "S7", {"exposure": 50.0})


def test_what_is_no_recording_is_said(tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "empty").mkdir()
    for name, words in (("notes.txt", "no video"), ("empty", "Expected images")):
        with pytest.raises(DataError, match=words):
            indexed(tmp_path / name)
    assert is_recording(str(tmp_path / "empty"))
    assert not is_recording("/dev/null")
    assert not is_recording("2BKRXXXX")
    assert not is_recording("http://a/?" + "9" * 5000)


def test_an_image_that_was_removed_meanwhile_is_said(forms, tmp_path):
    copied = shutil.copytree(forms["images"], tmp_path / "copy")
    recording = indexed(copied)
    (copied / "003.png").unlink()
    with pytest.raises(DataError, match=r"003\.png"):
        recording.frame(3)


@pytest.fixture
def many_chunks(frames, tmp_path, monkeypatch):
    """A chunk for each frame."""
    monkeypatch.setattr("gelform.sensors.recordings.mcap_writer.FLUSH_S", 0.0)
    recording = McapRecording(tmp_path / "many.mcap", RecordingFacts("ring"))
    for frame in frames:
        recording.write(frame)
    recording.close()
    return tmp_path / "many.mcap"


def test_frames_are_found_across_chunks(many_chunks, frames):
    index = McapIndex(many_chunks)
    for number in (6, 0, 5, 1, 4):
        found = index.frame(number)
        np.testing.assert_array_equal(found.image, frames[number].image)
        assert found.index == number


def test_a_killed_recorders_file_has_its_whole_chunks(many_chunks, frames, tmp_path):
    whole = many_chunks.read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(whole[: int(0.6 * len(whole))])
    index = McapIndex(torn)
    assert 2 <= len(index.times_s) < len(frames)
    np.testing.assert_array_equal(index.frame(1).image, frames[1].image)


def test_damaged_bytes_and_a_file_replaced_meanwhile_are_noticed(many_chunks, forms):
    index, content = McapIndex(many_chunks), bytearray(many_chunks.read_bytes())
    many_chunks.write_bytes(forms["mcap"].read_bytes())
    with pytest.raises(DataError):
        index.frame(5)
    content[len(content) // 2] ^= 0xFF
    many_chunks.write_bytes(bytes(content))
    with pytest.raises(DataError, match=r"many\.mcap"):
        McapIndex(many_chunks).frame(3)
