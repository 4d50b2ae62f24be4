"""`gelform live` as a process, and the flags of the Chromium that shows it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

FLAGS = ["--no-sandbox", "--enable-unsafe-swiftshader", "--no-first-run"]
CHROMIUM = os.environ.get("GELFORM_CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
COMPUTED_S = 25.0  # s until the simulated objects exist, which are computed while the first ones are shown


class Live:
    """`gelform live` as a separate process in its own folder; `words` are further arguments."""

    def __init__(self, folder: str, *words: str) -> None:
        self.started = time.monotonic()
        command = [sys.executable, "-m", "gelform", "live", *words, "--quiet", "--folder", folder]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()
        self.address = self.url.removeprefix("http://").rstrip("/")

    def resident_mb(self) -> float:
        """Memory of the process, if the system states it."""
        status = Path(f"/proc/{self.process.pid}/status").read_text(encoding="ascii")
        return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")) / 1024

    def close(self) -> None:
        """End it as Ctrl-C does."""
        self.process.terminate()
        self.process.wait(30)


@contextmanager
def running(*words: str) -> Iterator[tuple[Live, Path]]:
    """The server and its folder; `words` are further arguments."""
    with tempfile.TemporaryDirectory() as folder:
        live = Live(folder, *words)
        try:
            yield live, Path(folder)
        finally:
            live.close()
