"""Waiting for what other threads do."""

import time


def until(true, timeout_s=30.0):
    """Wait until something is true; what it gave."""
    stop = time.monotonic() + timeout_s
    while not (given := true()):
        assert time.monotonic() < stop, "it did not happen in time"
        time.sleep(0.01)
    return given
