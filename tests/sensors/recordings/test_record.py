"""Record what a grabber reads, all of it."""

import pytest

from gelform.errors import DataError
from gelform.sensors.grabber import Grabber
from gelform.sensors.recordings.record import KEPT_FRAMES, new_recording, record_frames
from gelform.sensors.source import open_source
from made.recorded import camera

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
        assert 0 < record_frames(grabber, recording, seconds=0.05).duration_s <= 0.05
        assert record_frames(grabber, recording, seconds=0).duration_s == 0


def test_the_time_is_that_of_the_frames_however_fast_they_are_read(tmp_path):
    with Grabber(camera(40, rate_hz=100.0), keep=KEPT_FRAMES) as grabber:
        first = new_recording(tmp_path / "first", grabber)
        record_frames(grabber, first, frames=30)
        first.close()
    with Grabber(lambda: open_source(tmp_path / "first"), keep=KEPT_FRAMES) as grabber:  # not paced
        stats = record_frames(grabber, new_recording(tmp_path / "again", grabber), seconds=0.1)
    assert 0.05 < stats.duration_s <= 0.1


def test_the_name_of_a_video_is_refused(tmp_path):
    with Grabber(camera(5)) as grabber, pytest.raises(DataError, match="name of a video"):
        new_recording(tmp_path / "r.MP4", grabber)


def test_the_name_says_which_kind(tmp_path):
    pytest.importorskip("mcap", reason="the extra mcap is not installed")
    with Grabber(camera(5, rate_hz=SLOW_HZ), keep=KEPT_FRAMES) as grabber:
        recording = new_recording(tmp_path / "r.mcap", grabber)
        record_frames(grabber, recording)
        recording.close()
    assert (tmp_path / "r.mcap").is_file()
    assert len(list(open_source(tmp_path / "r.mcap"))) == 5
