"""A recording from the page: whole, in order, and played again by what reads recordings."""

import numpy as np

import gelform
from gelform.live import actions
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
