"""Recording from a grabber, and the attachments of a recording; a folder of images, killed and damaged."""

import numpy as np
import pytest

from gelform.errors import CalibrationError, DataError
from gelform.image.frame import Frame
from gelform.sensors.grabber import Grabber
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.image_folder import (
    TIMES,
    FolderRecording,
    folder_summary,
    recorded_folder_playback,
)
from gelform.sensors.recordings.mcap_reader import mcap_summary
from gelform.sensors.recordings.record import (
    KEPT_FRAMES,
    attached_background,
    attached_calibration,
    attached_to,
    attachments_of,
    new_recording,
    record_frames,
)
from gelform.sensors.source import open_source
from made.recorded import FACTS, camera, frames, recorded

each_kind = pytest.mark.parametrize("name", ["a.mcap", "a"])


def written(path, attached):
    frame = Frame(np.zeros((8, 8, 3), np.uint8), 0.0, 10**18, 0)
    return recorded(path, [frame], RecordingFacts("ring"), attached)


@each_kind
def test_frames_are_played_as_they_were_recorded(name, tmp_path):
    facts = RecordingFacts("a camera", "S1", {"gain": 3.0, "reduced": 2}, 50.0, "abc")
    for encoded in (False, True):
        given = frames(6, encoded=encoded)
        path = recorded(tmp_path / f"{encoded}{name}", given, facts)
        source = open_source(path)
        assert (source.name, source.serial, source.rate_hz, source.live) == ("a camera", "S1", 50.0, False)
        assert source.settings == facts.settings
        for before, after in zip(given, source, strict=True):
            assert (after.index, after.wall_time_ns) == (before.index, before.wall_time_ns)
            assert after.time_s == pytest.approx(before.time_s - given[0].time_s, abs=1e-6)
            assert after.encoded == before.encoded
            assert after.image.shape == ((24, 32, 3) if encoded else before.image.shape)
            if not encoded:
                np.testing.assert_array_equal(after.image, before.image)
        summary = mcap_summary(path) if path.suffix else folder_summary(path)
        assert (summary.frames, summary.finished, summary.facts) == (6, True, facts)
        assert summary.duration_s == pytest.approx(6 / 50)
        with pytest.raises(DataError, match="there already"):
            recorded(path, given, facts)


@each_kind
def test_calibration_and_background_come_back_where_they_are(name, tmp_path, calibration):
    background = np.rint(calibration.background)
    path = written(tmp_path / name, attachments_of(calibration, background))
    assert attached_calibration(path).digest == calibration.digest
    np.testing.assert_array_equal(attached_background(path), background)
    bare = written(tmp_path / f"bare-{name}", {})
    assert attached_to(bare) == {}
    assert attached_calibration(bare) is None
    assert attached_background(bare) is None


@each_kind
def test_a_damaged_attachment_is_said(name, tmp_path, calibration):
    content = bytearray(attachments_of(calibration)["calibration.npz"])
    content[len(content) // 2] ^= 0xFF
    damaged = {"calibration.npz": bytes(content), "background.png": b"\x89PNG torn"}
    path = written(tmp_path / name, damaged)
    with pytest.raises(CalibrationError):
        attached_calibration(path)
    with pytest.raises(DataError, match=r"background\.png"):
        attached_background(path)


def test_what_is_no_attachment_or_of_no_size_is_refused(tmp_path, monkeypatch):
    (tmp_path / "background.png").write_bytes(b"x")
    assert attached_to(tmp_path) == {}
    path = written(tmp_path / "a.mcap", {"calibration.npz": bytes(2000)})
    monkeypatch.setattr("gelform.sensors.recordings.record.MAX_ATTACHMENT_BYTES", 1000)
    with pytest.raises(DataError, match="at most"):
        attached_to(path)


SLOW_HZ = 10.0  # at its own pace a camera passes over frames for which a busy machine has no time


def test_every_frame_is_written_and_gaps_are_counted(tmp_path):
    with Grabber(camera(12, rate_hz=SLOW_HZ), keep=KEPT_FRAMES) as grabber:
        recording = new_recording(tmp_path / "r", grabber, calibration_digest="abc")
        stats = record_frames(grabber, recording)
        recording.close()
    assert (stats.frames, stats.missing) == (12, 1)
    assert stats.duration_s == pytest.approx(12 / SLOW_HZ)
    source = open_source(tmp_path / "r")
    assert source.serial == "S1"
    assert [frame.index for frame in source] == [0, 1, 2, *range(4, 13)]


def test_stops_after_so_many_frames_or_when_told(tmp_path):
    with Grabber(camera(200), keep=KEPT_FRAMES) as grabber:
        recording = new_recording(tmp_path / "r", grabber)
        assert record_frames(grabber, recording, frames=3).frames == 3
        assert record_frames(grabber, recording, going_on=lambda stats: stats.frames < 2).frames == 2
        assert record_frames(grabber, recording, seconds=0.05).duration_s <= 0.05
        assert record_frames(grabber, recording, seconds=0).duration_s == 0


def test_the_time_is_that_of_the_frames_however_fast_they_are_read(tmp_path):
    with Grabber(camera(40, rate_hz=100.0), keep=KEPT_FRAMES) as grabber:
        first = new_recording(tmp_path / "first", grabber)
        record_frames(grabber, first, frames=30)
        first.close()
    with Grabber(lambda: open_source(tmp_path / "first"), keep=KEPT_FRAMES) as grabber:  # not paced
        stats = record_frames(grabber, new_recording(tmp_path / "again", grabber), seconds=0.1)
    assert 0.05 < stats.duration_s <= 0.1


def test_the_name_says_which_kind(tmp_path):
    with Grabber(camera(5, rate_hz=SLOW_HZ), keep=KEPT_FRAMES) as grabber:
        with pytest.raises(DataError, match="name of a video"):
            new_recording(tmp_path / "r.MP4", grabber)
        recording = new_recording(tmp_path / "r.mcap", grabber)
        record_frames(grabber, recording)
        recording.close()
    assert (tmp_path / "r.mcap").is_file()
    assert len(list(open_source(tmp_path / "r.mcap"))) == 5


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


def test_a_line_that_is_not_finished_is_where_the_recorder_was_killed(tmp_path):
    folder = recorded(tmp_path / "r", frames(6))
    assert folder_summary(folder).finished
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
