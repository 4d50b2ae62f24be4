"""Depth in millimeters of a visual-tactile sensor as topics of ROS 2."""

from __future__ import annotations

import os
import signal
import threading
from typing import Any


def interrupted(*_: Any) -> None:
    """End the process with one line: nothing has begun that would have to be closed."""
    os.write(2, b"gelform_ros: interrupted while starting\n")
    os._exit(130)


def interruptible(early: bool) -> None:
    """Let Ctrl-C end the process at once while modules load, which takes seconds; another's handler stays."""
    before, after = (signal.default_int_handler, interrupted)[:: 1 if early else -1]
    if threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) is before:
        signal.signal(signal.SIGINT, after)


interruptible(early=True)  # until `node` has loaded
