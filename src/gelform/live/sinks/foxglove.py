"""Results to Foxglove: a WebSocket server on this machine alone, since it asks neither for an Origin nor for a token."""

from __future__ import annotations

from typing import Any

import numpy as np

from gelform.errors import DataError, GelformError
from gelform.live.shown import Shown

HOST, PORT = "127.0.0.1", 8767
BACKLOG = 16  # messages that wait for a slow client; the oldest are dropped (1024 would be 300 MB)


class FoxgloveSink:
    """Topics `/sensor_N/image` (rgb8), `/sensor_N/indentation` (32FC1, metres, NaN where unknown), `/sensor_N/numbers`.

    Parameters
    ----------
    port : of the server; 0 for any that is free

    Raises
    ------
    DataError
        The extra `foxglove` is not installed.
    GelformError
        The port is taken.
    """

    def __init__(self, port: int = PORT) -> None:
        try:
            import foxglove
        except ImportError as problem:
            raise DataError("This needs the extra foxglove: pip install 'gelform[foxglove]'.") from problem
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name="gelform",
                host=HOST,
                port=port,
                context=self._context,
                message_backlog_size=BACKLOG,
            )
        except Exception as problem:  # of the extension's own kind
            raise GelformError(
                f"Foxglove's server cannot listen on {HOST}:{port}: {problem}. Another program, perhaps another gelform "
                "live, uses the port: end it."
            ) from problem
        self._channels: dict[str, Any] = {}
        self.address = f"ws://{HOST}:{self._server.port}"
        self.how = f"Foxglove: open a connection to {self.address} (WebSocket)."

    def show(self, name: str, shown: Shown) -> None:
        """Send a frame to the clients that are there."""
        stamp = shown.frame.wall_time_ns
        self._image(f"/{name}/image", shown.image, "rgb8", stamp)
        if shown.result is not None:
            metres = (shown.result.depth_mm * np.float32(1e-3)).astype("<f4")
            metres[~shown.result.known] = np.nan
            self._image(f"/{name}/indentation", metres, "32FC1", stamp)
        if shown.measures is not None:
            numbers = {
                "peak": shown.measures.peak,
                "area": shown.measures.area,
                "volume": shown.measures.volume,
            }
            self._channel(f"/{name}/numbers", None).log(numbers, log_time=stamp)

    def close(self) -> None:
        """Close the connections."""
        self._server.stop()

    def _image(self, topic: str, pixels: Any, encoding: str, stamp_ns: int) -> None:
        from foxglove.messages import RawImage, Timestamp

        seconds, nanoseconds = divmod(stamp_ns, 10**9)
        data = np.ascontiguousarray(pixels).tobytes()
        height, width = pixels.shape[:2]
        message = RawImage(
            timestamp=Timestamp(sec=seconds, nsec=nanoseconds),
            frame_id=topic.split("/")[1],
            width=width,
            height=height,
            encoding=encoding,
            step=len(data) // height,
            data=data,
        )
        self._channel(topic, "RawImageChannel").log(message, log_time=stamp_ns)

    def _channel(self, topic: str, kind: str | None) -> Any:
        if topic not in self._channels:
            import foxglove
            from foxglove import channels

            make = foxglove.Channel if kind is None else getattr(channels, kind)
            self._channels[topic] = make(topic, context=self._context)
        return self._channels[topic]
