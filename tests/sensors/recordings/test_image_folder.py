"""A recording as a folder of images: there and back, killed, damaged."""

import pytest

from gelform.errors import DataError
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.image_folder import (
    TIMES,
    FolderRecording,
    folder_summary,
    recorded_folder_playback,
)
from made.recorded import frames

FACTS = RecordingFacts("a camera", "S1", {"gain": 3.0}, 50.0, "abc")


def recorded(path, given):
    recording = FolderRecording(path, FACTS)
    for frame in given:
        recording.write(frame)
    recording.close()
    return path


def test_a_summary_counts_without_reading_pictures(tmp_path):
    folder = recorded(tmp_path / "r", frames(6))
    (folder / "00000001.png").unlink()
    summary = folder_summary(folder)
    assert (summary.frames, summary.finished, summary.facts) == (6, True, FACTS)
    assert summary.duration_s == pytest.approx(6 / 50)


def test_a_recorder_that_is_killed_between_two_frames_has_not_finished(tmp_path):
    recording = FolderRecording(tmp_path / "r", FACTS)
    for frame in frames(6):
        recording.write(frame)
    summary = folder_summary(tmp_path / "r")  # as a kill would leave it: every line is whole
    assert (summary.frames, summary.finished, summary.facts) == (6, False, FACTS)
    recording.close()
    recording.close()
    assert folder_summary(tmp_path / "r").finished


def test_a_folder_of_a_recorder_that_did_not_say_is_finished_where_its_table_is(tmp_path):
    folder = recorded(tmp_path / "r", frames(6))
    (folder / "recording.json").write_text(FACTS.to_json())
    assert folder_summary(folder).finished


def test_a_line_that_is_not_finished_is_where_the_recorder_was_killed(tmp_path):
    folder = recorded(tmp_path / "r", frames(6))
    text = (folder / TIMES).read_text()
    (folder / TIMES).write_text(text[:-5])
    assert len(list(recorded_folder_playback(folder))) == 5
    summary = folder_summary(folder)
    assert (summary.frames, summary.finished) == (5, False)


def test_damage_says_where(tmp_path):
    folder = recorded(tmp_path / "r", frames(3))
    (folder / "00000001.png").unlink()
    with pytest.raises(DataError, match=r"Cannot read .*00000001\.png"):
        list(recorded_folder_playback(folder))
    (folder / TIMES).write_text((folder / TIMES).read_text().replace("00000000.png", "x,y"))
    with pytest.raises(DataError, match=r"frames\.csv is damaged"):
        list(recorded_folder_playback(folder))
    (folder / TIMES).write_text("a,b\n")
    with pytest.raises(DataError, match="Expected the columns"):
        list(recorded_folder_playback(folder))
