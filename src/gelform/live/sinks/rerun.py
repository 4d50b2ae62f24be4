"""Results to a Rerun viewer that runs on this machine."""

from __future__ import annotations

import socket
from typing import Any

from gelform.errors import DataError, GelformError
from gelform.live.shown import Shown

HOST, PORT = "127.0.0.1", 9876
PER_METRE = 1000.0  # depth is mm


class RerunSink:
    """Entities `sensor_N/image`, `sensor_N/depth` (mm) and the numbers `sensor_N/peak`, `area`, `volume`.

    Parameters
    ----------
    port : of the viewer

    Raises
    ------
    DataError
        The extra `rerun` is not installed.
    GelformError
        No viewer answers.
    """

    def __init__(self, port: int = PORT) -> None:
        try:
            import rerun
        except ImportError as problem:
            raise DataError("This needs the extra rerun: pip install 'gelform[rerun]'.") from problem
        try:
            socket.create_connection((HOST, port), timeout=2).close()
        except OSError as problem:
            raise GelformError(
                f"No Rerun viewer answers at {HOST}:{port}. Start one in another terminal: rerun."
            ) from problem
        self._rerun: Any = rerun
        self._recording = rerun.RecordingStream("gelform")
        self._recording.connect_grpc(f"rerun+http://{HOST}:{port}/proxy")
        self.how = f"Rerun: the viewer at {HOST}:{port} shows it."

    def show(self, name: str, shown: Shown) -> None:
        """Send a frame to the viewer."""
        log, rerun = self._recording.log, self._rerun
        self._recording.set_time("taken", timestamp=shown.frame.wall_time_ns / 1e9)
        log(f"{name}/image", rerun.Image(shown.image))
        if shown.result is not None:
            log(f"{name}/depth", rerun.DepthImage(shown.result.depth_mm, meter=PER_METRE))
        if shown.measures is not None:
            for what in ("peak", "area", "volume"):
                log(f"{name}/{what}", rerun.Scalars(getattr(shown.measures, what)))

    def close(self) -> None:
        """Send what is left."""
        self._recording.disconnect()
