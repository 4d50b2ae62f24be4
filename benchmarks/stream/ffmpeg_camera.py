"""A camera at an address that can be switched off: a real ffmpeg process that serves Motion JPEG over HTTP."""

from __future__ import annotations

import contextlib
import random
import shutil
import socket
import subprocess
import time
from pathlib import Path

FFMPEG = shutil.which("ffmpeg")
STARTED_S = 30.0
LISTENING, ESTABLISHED = "0A", "01"  # in /proc/net/tcp, by the address of this end


class FfmpegCamera:
    """Serves a generated test picture, or a file of JPEG pictures in a loop, to one client.

    Parameters
    ----------
    source : ffmpeg's options for the input, such as "-f lavfi -i testsrc2=size=320x240:rate=30 -c:v mjpeg"
    """

    def __init__(self, source: str = "-f lavfi -i testsrc2=size=320x240:rate=30 -c:v mjpeg -q:v 3") -> None:
        self.port = _free_port()
        self.url = f"http://127.0.0.1:{self.port}/stream"
        self._command = f"{FFMPEG} -loglevel quiet -re {source} -f mpjpeg -listen 1 {self.url}".split()
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> float:
        """Switch it on; return the last monotonic time at which it did not listen yet."""
        self._process = subprocess.Popen(self._command, stdin=subprocess.DEVNULL)
        until = time.monotonic() + STARTED_S
        before = looked = time.monotonic()
        while not self._listens():
            if looked > until or self._process.poll() is not None:
                raise RuntimeError(f"ffmpeg does not listen: {' '.join(self._command)}")
            time.sleep(0.002)
            before, looked = looked, time.monotonic()
        return before

    def kill(self) -> None:
        """Switch it off, as by pulling its plug."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def __enter__(self) -> FfmpegCamera:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    def _listens(self) -> bool:
        """Whether the kernel's table lists it as listening or connected.

        A test connection would take its only client's place.
        """
        rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
        return any(
            row[1].endswith(f":{self.port:04X}") and row[3] in (LISTENING, ESTABLISHED) for row in rows
        )


def _free_port() -> int:
    """A port below the range that the kernel gives to clients, so that none takes it while the camera is off."""
    for port in random.SystemRandom().sample(range(20000, 30000), 100):
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port
    raise RuntimeError("no free port between 20000 and 30000")


def why_absent() -> str | None:
    """The reason why such a camera is impossible here; None if it is possible."""
    if FFMPEG is None:
        return "ffmpeg is not installed"
    return None if Path("/proc/net/tcp").exists() else "needs Linux's /proc/net/tcp"
