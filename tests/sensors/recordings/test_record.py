"""Recording from a grabber, and the attachments of a recording."""

import threading
import time

import numpy as np
import pytest

from gelform.errors import CalibrationError, DataError
from gelform.image.frame import Frame
from gelform.sensors.grabber import Grabber
from gelform.sensors.playback import Playback
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.mcap_reader import mcap_summary
from gelform.sensors.recordings.mcap_writer import McapRecording
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
from made.recorded import camera, frames, recorded


def written(path, attached):
    frame = Frame(np.zeros((8, 8, 3), np.uint8), 0.0, 10**18, 0)
    return recorded(path, [frame], RecordingFacts("ring"), attached)


def test_frames_are_played_as_they_were_recorded(tmp_path):
    facts = RecordingFacts("a camera", "S1", {"gain": 3.0, "reduced": 2}, 50.0, "abc")
    for encoded in (False, True):
        given = frames(6, encoded=encoded)
        path = recorded(tmp_path / f"{encoded}.mcap", given, facts)
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
        summary = mcap_summary(path)
        assert (summary.frames, summary.finished, summary.facts) == (6, True, facts)
        assert summary.duration_s == pytest.approx(6 / 50)
        with pytest.raises(DataError, match="there already"):
            recorded(path, given, facts)


def test_calibration_and_background_come_back_where_they_are(tmp_path, calibration):
    background = np.rint(calibration.background)
    path = written(tmp_path / "a.mcap", attachments_of(calibration, background))
    assert attached_calibration(path).digest == calibration.digest
    np.testing.assert_array_equal(attached_background(path), background)
    bare = written(tmp_path / "bare.mcap", {})
    assert attached_to(bare) == {}
    assert attached_calibration(bare) is None
    assert attached_background(bare) is None


def test_a_damaged_attachment_is_said(tmp_path, calibration):
    content = bytearray(attachments_of(calibration)["calibration.npz"])
    content[len(content) // 2] ^= 0xFF
    damaged = {"calibration.npz": bytes(content), "background.png": b"\x89PNG torn"}
    path = written(tmp_path / "a.mcap", damaged)
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
        recording = new_recording(tmp_path / "r.mcap", grabber, calibration_digest="abc")
        stats = record_frames(grabber, recording)
        recording.close()
    assert (stats.frames, stats.missing) == (12, 1)
    assert stats.duration_s == pytest.approx(12 / SLOW_HZ)
    source = open_source(tmp_path / "r.mcap")
    assert source.serial == "S1"
    assert [frame.index for frame in source] == [0, 1, 2, *range(4, 13)]


def test_stops_after_so_many_frames_or_when_told(tmp_path):
    with Grabber(camera(200), keep=KEPT_FRAMES) as grabber:
        recording = new_recording(tmp_path / "r.mcap", grabber)
        assert record_frames(grabber, recording, frames=3).frames == 3
        assert record_frames(grabber, recording, going_on=lambda stats: stats.frames < 2).frames == 2
        assert record_frames(grabber, recording, seconds=0.05).duration_s <= 0.05
        assert record_frames(grabber, recording, seconds=0).duration_s == 0


def test_the_time_is_that_of_the_frames_however_fast_they_are_read(tmp_path):
    first = McapRecording(tmp_path / "first.mcap", RecordingFacts("x", None, {}, 100.0))
    for k in range(30):
        first.write(Frame(np.full((8, 10, 3), k, np.uint8), k / 100, 10**18 + k, k))
    first.close()
    with Grabber(lambda: open_source(tmp_path / "first.mcap"), keep=KEPT_FRAMES) as grabber:  # not paced
        stats = record_frames(grabber, new_recording(tmp_path / "again.mcap", grabber), seconds=0.105)
    assert (stats.frames, stats.missing) == (11, 0)
    assert stats.duration_s == pytest.approx(0.1)


def test_a_recording_that_is_read_slowly_is_not_cut_by_our_clock(tmp_path):
    written = threading.Event()

    def frames():
        for k in range(6):
            if k == 1:
                written.wait(10)
                time.sleep(0.3)  # longer than one wait for a frame, and than what is to be recorded
            yield Frame(np.full((8, 10, 3), k, np.uint8), k / 100, 10**18 + k, k)

    def going_on(stats):
        if stats.frames:
            written.set()
        return True

    with Grabber(lambda: Playback(frames, RecordingFacts("x", rate_hz=100.0)), keep=KEPT_FRAMES) as grabber:
        recording = new_recording(tmp_path / "r.mcap", grabber)
        stats = record_frames(grabber, recording, seconds=0.045, going_on=going_on)
    assert stats.frames == 5


def test_the_name_is_that_of_an_mcap_file(tmp_path):
    with Grabber(camera(5), keep=KEPT_FRAMES) as grabber:
        for name in ("r.MP4", "r"):
            with pytest.raises(DataError, match=r"Expected a new file \*\.mcap"):
                new_recording(tmp_path / name, grabber)
    assert not list(tmp_path.iterdir())
