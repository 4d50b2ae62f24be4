"""The real Rerun viewer's receiver, without a window: what it wrote down is what was shown."""

import os
import signal
import socket
import subprocess
import sys
import time

import pytest

rerun = pytest.importorskip("rerun", reason="the extra rerun is not installed")

from gelform.errors import GelformError  # noqa: E402
from gelform.live.sinks.rerun import HOST, RerunSink  # noqa: E402
from live_waiting import until  # noqa: E402


def free_port():
    with socket.socket() as one:
        one.bind((HOST, 0))
        return one.getsockname()[1]


def answers(port):
    try:
        socket.create_connection((HOST, port), timeout=1).close()
    except OSError:
        return False
    return True


def test_a_viewer_gets_images_depth_and_numbers(shown, tmp_path):
    port, saved = free_port(), tmp_path / "seen.rrd"
    command = [sys.executable, "-m", "rerun", "--save", str(saved), "--port", str(port), "--bind", HOST]
    with subprocess.Popen(command, start_new_session=True) as receiver:  # it starts another program
        try:
            until(lambda: answers(port), 60)
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
    port = free_port()
    with pytest.raises(GelformError, match=rf"No Rerun viewer answers at 127\.0\.0\.1:{port}\. Start one"):
        RerunSink(port)
