"""Sinks: the newest frame wins, a failure ends only one; the real server of Foxglove, the real receiver of Rerun."""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from gelform.errors import DataError, GelformError
from gelform.live.sinks import HOST, SINKS, Feeder, FoxgloveSink, RerunSink, feed
from live_waiting import answers, free_port, until


class Recorded:
    """Shows frames, each when it is let; or fails at its first one."""

    def __init__(self, fails=None):
        self.let, self.busy, self.closed = threading.Event(), threading.Event(), False
        self.serials, self.names, self._fails = [], set(), fails

    def show(self, name, shown):
        if self._fails is not None:
            raise self._fails
        self.busy.set()
        assert self.let.wait(10)
        self.serials.append(shown.serial)
        self.names.add(name)

    def close(self):
        self.closed = True


def test_a_slow_sink_is_given_the_newest_and_holds_nobody_up(hub, station):
    sink = Recorded()
    feeder = Feeder(hub, sink, "slow")
    assert sink.busy.wait(10)
    assert hub.watched()
    held = station.newest.serial
    until(lambda: station.newest.serial > held + 5)  # the station goes on while the sink stands still
    passed_over = station.newest.serial
    sink.let.set()
    until(lambda: len(sink.serials) >= 3)
    feeder.close()
    assert sink.serials[0] <= held
    assert sink.serials[1] >= passed_over
    assert sink.serials == sorted(set(sink.serials))
    assert (sink.names, sink.closed, hub.sinks) == ({"sensor_0"}, True, 0)


def test_a_sink_that_fails_is_a_notice_and_the_page_goes_on(hub, station):
    sink = Recorded(fails=RuntimeError("the other program is gone"))
    Feeder(hub, sink, "rerun")
    until(lambda: sink.closed)
    assert hub.sinks == 0
    assert hub.notices[-1][1:] == ("error", "rerun ended: RuntimeError: the other program is gone")
    before = station.newest.serial
    until(lambda: station.newest.serial > before + 2)


@pytest.mark.parametrize("paused", [False, True])
def test_it_closes_whether_or_not_frames_come(hub, station, paused):
    sink, station.paused = Recorded(), paused
    sink.let.set()
    Feeder(hub, sink, "slow").close()
    assert sink.closed


def test_none_is_fine_and_an_unknown_one_is_named(hub):
    assert feed(hub, []) == ([], [])
    with pytest.raises(ValueError, match="sinks among rerun, foxglove, got rviz"):
        feed(hub, ["rerun", "rviz"])


@pytest.mark.parametrize("name", SINKS)
def test_without_its_extra_it_is_named(hub, name):
    if importlib.util.find_spec(name) is not None:
        pytest.skip(f"{name} is installed")
    with pytest.raises(DataError, match=r'needs the extra sinks: pip install "gelform\[sinks\]"'):
        feed(hub, [name])


TCP, LISTENING = Path("/proc/net/tcp"), "0A"
MESSAGE_DATA = 1  # opcode of the protocol: then subscription u32, log time u64, the message


@pytest.fixture
def sink():
    pytest.importorskip("foxglove", reason="the extra sinks is not installed")
    made = FoxgloveSink(0)
    yield made
    made.close()


def test_a_client_gets_images_and_numbers(sink, shown):
    sink.show("sensor_0", shown)  # topics are announced with their first message
    connect = pytest.importorskip("websockets.sync.client").connect
    with connect(sink.address, subprotocols=["foxglove.sdk.v1"]) as client:
        topics = {}
        while len(topics) < 3:
            said = json.loads(client.recv(timeout=10))
            topics |= {one["topic"]: one for one in said.get("channels", [])}
        wanted = topics["/sensor_0/indentation"]
        asked = {"op": "subscribe", "subscriptions": [{"id": 7, "channelId": wanted["id"]}]}
        client.send(json.dumps(asked))
        message = None
        for _ in range(50):
            sink.show("sensor_0", shown)
            try:
                message = client.recv(timeout=0.2)
            except TimeoutError:
                continue
            if isinstance(message, bytes) and message[0] == MESSAGE_DATA:
                break
    assert set(topics) == {"/sensor_0/image", "/sensor_0/indentation", "/sensor_0/numbers"}
    assert wanted["schemaName"] == "foxglove.RawImage"
    subscription, stamp_ns = struct.unpack("<IQ", message[1:13])
    assert (subscription, stamp_ns) == (7, shown.frame.wall_time_ns)
    meters = shown.result.depth_mm * np.float32(1e-3)
    meters[~shown.result.known] = np.nan
    assert meters.astype("<f4").tobytes() in message


@pytest.mark.skipif(not TCP.is_file(), reason="reads Linux's table of sockets")
def test_only_this_machine_can_connect(sink):
    port = int(sink.address.rpartition(":")[2])
    sockets = [line.split() for line in TCP.read_text().splitlines()[1:]]
    listening = [one[1] for one in sockets if one[3] == LISTENING and int(one[1].split(":")[1], 16) == port]
    assert listening == [f"0100007F:{port:04X}"]  # 127.0.0.1


def test_a_port_that_is_taken_is_said(sink):
    port = int(sink.address.rpartition(":")[2])
    with pytest.raises(GelformError, match=rf"cannot listen on 127\.0\.0\.1:{port}.*End it"):
        FoxgloveSink(port)


@pytest.mark.slow
def test_a_viewer_gets_images_depth_and_numbers(shown, tmp_path):
    pytest.importorskip("rerun", reason="the extra sinks is not installed")
    port, saved = free_port(), tmp_path / "seen.rrd"
    command = [sys.executable, "-m", "rerun", "--save", str(saved), "--port", str(port), "--bind", HOST]
    with subprocess.Popen(command, start_new_session=True) as receiver:  # it starts another program
        try:
            until(lambda: answers(port))
            sink = RerunSink(port)
            sink.show("sensor_0", shown)
            sink.close()
            time.sleep(1)
        finally:
            os.killpg(receiver.pid, signal.SIGTERM)
            receiver.wait(20)
    written = saved.read_bytes()
    for entity in ("image", "depth", "peak", "area", "volume"):
        assert f"/sensor_0/{entity}".encode() in written


def test_no_viewer_is_said():
    pytest.importorskip("rerun", reason="the extra sinks is not installed")
    port = free_port()
    with pytest.raises(GelformError, match=rf"No Rerun viewer answers at 127\.0\.0\.1:{port}\. Start one"):
        RerunSink(port)
