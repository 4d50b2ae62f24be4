"""The newest frame wins, whatever a sink does; what it raises is said and ends it alone."""

import threading

import pytest

from gelform.live.sinks.feeder import Feeder
from live_waiting import until


class Slow:
    """Shows a frame when it is let."""

    def __init__(self):
        self.let, self.busy, self.closed = threading.Event(), threading.Event(), False
        self.serials, self.names = [], set()

    def show(self, name, shown):
        self.busy.set()
        assert self.let.wait(10)
        self.serials.append(shown.serial)
        self.names.add(name)

    def close(self):
        self.closed = True


def test_a_slow_sink_is_given_the_newest_and_holds_nobody_up(hub):
    sink, station = Slow(), hub.stations[0]
    feeder = Feeder(hub, sink, "slow")
    assert sink.busy.wait(10)
    held = station.newest.serial
    until(lambda: station.newest.serial > held + 5)  # the station goes on while the sink stands still
    passed_over = station.newest.serial
    sink.let.set()
    until(lambda: len(sink.serials) >= 3)
    feeder.close()
    assert sink.serials[0] <= held
    assert sink.serials[1] >= passed_over
    assert sink.serials == sorted(set(sink.serials))
    assert sink.names == {"sensor_0"}
    assert sink.closed


class Broken:
    """Fails at its first frame."""

    closed = False

    def show(self, name, shown):
        raise RuntimeError("the other program is gone")

    def close(self):
        self.closed = True


def test_a_sink_that_fails_is_a_notice_and_the_page_goes_on(hub):
    sink, station = Broken(), hub.stations[0]
    Feeder(hub, sink, "rerun")
    until(lambda: sink.closed)
    assert hub.notices[-1][1:] == ("error", "rerun ended: RuntimeError: the other program is gone")
    before = station.newest.serial
    until(lambda: station.newest.serial > before + 2)


@pytest.mark.parametrize("paused", [False, True])
def test_it_closes_whether_or_not_frames_come(hub, paused):
    sink = Slow()
    sink.let.set()
    hub.stations[0].paused = paused
    Feeder(hub, sink, "slow").close()
    assert sink.closed
