"""A recording in a thread of its own ends by itself; one file plays elsewhere as it was shown here."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import gelform
from gelform.sensors.grabber import Grabber
from gelform.sensors.recordings import attached_background, attached_calibration
from gelform.sensors.recordings.indexed import indexed
from gelform.sensors.recordings.record import KEPT_FRAMES
from gelform.sensors.recordings.recorder import Recorder, share
from live_waiting import until
from made.sources import ImageSource


@pytest.mark.parametrize("form", ["mcap", "images", "video"])
def test_the_file_holds_frames_times_and_calibration(form, forms, frames, calibration, tmp_path):
    recording = indexed(forms[form])
    background = np.rint(calibration.background)
    path = share(recording, tmp_path, calibration=calibration, background=background)
    again = indexed(path)
    np.testing.assert_allclose(again.times_s, recording.times_s, atol=1e-6)
    np.testing.assert_array_equal(again.frame(4).image, frames[4].image)
    assert attached_calibration(path).digest == calibration.digest
    np.testing.assert_array_equal(attached_background(path), background)
    here = gelform.Reconstructor(calibration, background=background)(recording.frame(4))
    there = gelform.Reconstructor(attached_calibration(path), background=attached_background(path))
    np.testing.assert_array_equal(there(again.frame(4)).depth_mm, here.depth_mm)


def test_progress_is_told_and_nothing_is_left_of_a_share_that_failed(forms, tmp_path, monkeypatch):
    monkeypatch.setattr("gelform.sensors.recordings.recorder.named_by_time", lambda _: "a")
    said = []
    recording = indexed(forms["mcap"])
    path = share(recording, tmp_path, calibration=None, progress=lambda *what: said.append(what[:2]))
    assert said[-1] == (6, 7)
    again = share(recording, tmp_path, calibration=None)  # in the same second
    assert (again.name, len(indexed(again))) == ("a-2.mcap", 7)
    assert attached_calibration(path) is None
    monkeypatch.setattr("gelform.sensors.recordings.recorder.named_by_time", lambda _: "b")

    def stop(done, *_):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        share(recording, tmp_path, calibration=None, progress=stop)
    assert {path.name for path in tmp_path.glob("*.mcap*")} == {"a.mcap", "a-2.mcap"}
    assert not list(tmp_path.glob(".*"))


def test_it_ends_when_it_is_large_enough_or_no_longer_wanted(frames, calibration, tmp_path):
    limit, images = 100_000, [frame.image for frame in frames]
    with Grabber(lambda: ImageSource(images), keep=KEPT_FRAMES) as grabber:
        for folder, how, said in (
            ("large", {"max_bytes": limit}, "its limit of"),
            ("unwanted", {"wanted": lambda: False}, "the page that began it was closed"),
        ):
            ended = []
            (tmp_path / folder).mkdir()
            recorder = Recorder(
                grabber, tmp_path / folder, calibration=calibration, on_ended=ended.append, **how
            )
            recorder.start()
            until(lambda ended=ended: ended)
            assert said in recorder.problem
            assert attached_calibration(recorder.path).digest == calibration.digest
            if folder == "large":
                frame_bytes = recorder.stats.written_bytes / recorder.stats.frames
                assert limit <= recorder.stats.written_bytes < limit + 2 * frame_bytes


def test_two_sensors_in_one_second_are_both_kept(forms, frames, calibration, tmp_path, monkeypatch):
    """Recorded and shared at the same time, by two stations' threads."""
    monkeypatch.setattr("gelform.sensors.recordings.recorder.named_by_time", lambda kind: kind)
    images, recording = [frame.image for frame in frames], indexed(forms["mcap"])
    with Grabber(lambda: ImageSource(images), keep=KEPT_FRAMES) as grabber:
        recorders = [Recorder(grabber, tmp_path, calibration=calibration, max_bytes=1) for _ in range(2)]
        for one in recorders:
            one.start()
        with ThreadPoolExecutor(4) as pool:
            shared = list(pool.map(lambda _: share(recording, tmp_path, calibration=None), range(4)))
        until(lambda: all(one.problem for one in recorders))
        for one in recorders:
            one.close()
    assert len({*shared, *(one.path for one in recorders)}) == 6
    assert [len(indexed(path)) for path in shared] == [7] * 4
    assert all(len(indexed(one.path)) >= 1 for one in recorders)
