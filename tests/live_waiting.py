"""Waiting for the work of other threads and programs."""

import socket
import time

from gelform.sensors.simulated import PRESS_S

HANGS_S = 120.0  # what has not come by then, in seconds, never will: a busy machine is twenty times slower


def until(true, timeout_s=HANGS_S):
    """Wait until something is true; what it gave."""
    stop = time.monotonic() + timeout_s
    while not (given := true()):
        assert time.monotonic() < stop, "it did not happen in time"
        time.sleep(0.01)
    return given


def free_port():
    """A port of this machine that nobody listens on."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def answers(port):
    """Whether a program of this machine listens on a port."""
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1).close()
    except OSError:
        return False
    return True


def next_of(socket, wanted, timeout_s=HANGS_S):
    """The next message of a websocket, bytes or words, of which something is wanted: that."""
    stop = time.monotonic() + timeout_s
    while time.monotonic() < stop:
        if found := wanted(socket.recv(timeout=timeout_s)):
            return found
    raise AssertionError("it did not come")


def held(station, x_px, y_px, depth_mm):
    """Press the simulated sensor and keep it pressed; the first frame taken once the ball is all the way in."""
    station.source.press_at(x_px, y_px, depth_mm, held_s=600)
    still_s = time.monotonic() + PRESS_S + 0.1
    return until(lambda: one if (one := station.newest) and one.frame.time_s > still_s else None)
