"""Recordings from the page are complete; one file plays elsewhere as it was shown here."""

from __future__ import annotations

import numpy as np
import pytest

import gelform
from gelform.errors import DataError
from gelform.live import actions
from gelform.live.recorder import Recorder, share
from gelform.sensors.recordings import attached_background, attached_calibration
from gelform.sensors.recordings.indexed import indexed
from live_waiting import until


def test_frames_are_kept_as_they_came(hub, tmp_path):
    hub.folder = tmp_path
    actions.record(hub, 0, True)
    recorder = hub.recorders[0]
    until(lambda: recorder.stats.frames >= 8)
    assert hub.facts()["recordings"][0]["frames"] >= 8
    actions.record(hub, 0, False)
    assert not hub.recorders
    assert recorder.path.name in hub.notices[-1][2]
    with gelform.open_source(recorder.path) as source:
        frames = list(source)
    assert len(frames) == recorder.stats.frames
    assert [frame.index for frame in frames] == sorted({frame.index for frame in frames})
    assert frames[0].image.shape == hub.stations[0].newest.frame.image.shape
    assert np.diff([frame.time_s for frame in frames]).min() > 0


def test_twice_on_and_twice_off_do_no_harm(hub, tmp_path):
    hub.folder = tmp_path
    actions.record(hub, 0, True)
    first = hub.recorders[0]
    actions.record(hub, 0, True)
    assert hub.recorders[0] is first
    actions.record(hub, 0, False)
    actions.record(hub, 0, False)
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("form", ["mcap", "images", "video"])
def test_the_file_holds_frames_times_and_calibration(form, forms, frames, calibration, tmp_path):
    recording = indexed(forms[form])
    background = np.rint(calibration.background)
    path = share(recording, tmp_path / "one.mcap", calibration=calibration, background=background)
    again = indexed(path)
    np.testing.assert_allclose(again.times_s, recording.times_s, atol=1e-6)
    np.testing.assert_array_equal(again.frame(4).image, frames[4].image)
    assert attached_calibration(path).digest == calibration.digest
    np.testing.assert_array_equal(attached_background(path), background)
    here = gelform.Reconstructor(calibration, background=background)(recording.frame(4))
    there = gelform.Reconstructor(attached_calibration(path), background=attached_background(path))
    np.testing.assert_array_equal(there(again.frame(4)).depth_mm, here.depth_mm)


def test_progress_is_told_and_nothing_is_left_of_a_share_that_failed(forms, tmp_path):
    said = []
    recording = indexed(forms["mcap"])
    share(recording, tmp_path / "a.mcap", calibration=None, progress=lambda *what: said.append(what[:2]))
    assert said[-1] == (6, 7)
    with pytest.raises(DataError, match="already there"):
        share(recording, tmp_path / "a.mcap", calibration=None)
    assert attached_calibration(tmp_path / "a.mcap") is None

    def stop(done, *_):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        share(recording, tmp_path / "b.mcap", calibration=None, progress=stop)
    assert [path.name for path in tmp_path.glob("*.mcap*")] == ["a.mcap"]
    assert not list(tmp_path.glob(".*"))


def test_it_ends_with_the_page_that_began_it(hub, tmp_path, monkeypatch):
    monkeypatch.setattr("gelform.live.web.pages.GRACE_S", 0.05)
    hub.folder = tmp_path
    hub.pages.came("page-one")
    actions.record(hub, 0, True, "page-one")
    recorder = hub.recorders[0]
    until(lambda: recorder.stats.frames >= 3)
    hub.pages.left("page-one")
    until(lambda: not hub.recorders)
    until(lambda: hub.notices)
    assert "the page that began it was closed" in hub.notices[-1][2]
    assert hub.notices[-1][1] == "warning"
    assert [one["name"] for one in hub.recordings.facts()] == [recorder.path.name]
    with gelform.open_source(recorder.path) as source:
        assert len(list(source)) == recorder.stats.frames


def test_it_ends_when_it_is_large_enough(hub, tmp_path):
    station, ended = hub.stations[0], []
    limit = 100_000
    recorder = Recorder(station.grabber, tmp_path, station.setup, on_ended=ended.append, max_bytes=limit)
    recorder.start()
    until(lambda: ended)
    assert "its limit of" in recorder.problem
    frame_bytes = recorder.stats.written_bytes / recorder.stats.frames
    assert limit <= recorder.stats.written_bytes < limit + 2 * frame_bytes
