"""Other programs that show the results of the page: Rerun (extra `sinks`), Foxglove (extra `sinks`).

The newest frame wins, and a slow sink delays nothing else. Foxglove's server listens only on this machine, because it checks
neither an Origin nor a token.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any, Protocol

import numpy as np

from gelform.errors import GelformError, needed
from gelform.live.hub import Hub
from gelform.live.shown import ShownFrame
from gelform.robots.ros_messages import indentation_m

HOST = "127.0.0.1"


class Sink(Protocol):
    """Another program that shows results; `how` is a sentence that says where."""

    how: str

    def show(self, name: str, shown: ShownFrame) -> None:
        """Show one frame of a sensor, in the feeder's thread; `name` is a path of letters, digits and _."""

    def close(self) -> None:
        """Stop showing."""


class Feeder:
    """Gives a sink the newest frame of each station; frames that arrive while it is busy are skipped.

    The sink is closed with the feeder. An exception of the sink ends it and becomes a notice of the hub, which names it;
    the page continues.
    """

    def __init__(self, hub: Hub, sink: Sink, name: str) -> None:
        self._hub, self._sink, self._name = hub, sink, name
        self._newer, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"sink {name}", daemon=True)
        hub.listen(self._newer.set)
        hub.sinks += 1
        self._thread.start()

    def close(self) -> None:
        """Stop, and close the sink."""
        self._stop.set()
        self._newer.set()
        self._thread.join(3.0)

    def _run(self) -> None:
        serials: dict[int, int] = {}
        try:
            while not self._stop.is_set():
                self._newer.wait()
                self._newer.clear()
                for station in self._hub.stations:
                    shown = station.newest
                    if shown is not None and shown.serial != serials.get(station.number):
                        serials[station.number] = shown.serial
                        self._sink.show(f"sensor_{station.number}", shown)
        except Exception as problem:  # from another program's library; the page continues without it
            self._hub.notice(f"{self._name} ended: {type(problem).__name__}: {problem}", "error")
        finally:
            self._hub.sinks -= 1
            self._sink.close()


class RerunSink:
    """Entities `sensor_N/image`, `sensor_N/depth` (mm, NaN where unknown) and the numbers `sensor_N/peak`, `area`, `volume`.

    `port` is the viewer's. DataError: the extra `sinks` is not installed. GelformError: no viewer answers.
    """

    def __init__(self, port: int = 9876) -> None:  # Rerun's default
        rerun = needed("rerun", "sinks", "Sending to Rerun")
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

    def show(self, name: str, shown: ShownFrame) -> None:
        """Send a frame to the viewer."""
        log, rerun = self._recording.log, self._rerun
        self._recording.set_time("taken", timestamp=shown.frame.wall_time_ns / 1e9)
        log(f"{name}/image", rerun.Image(shown.image))
        if shown.result is not None:
            depth_mm = np.where(shown.result.known, shown.result.depth_mm, np.float32(np.nan))
            log(f"{name}/depth", rerun.DepthImage(depth_mm, meter=1000.0))
        if shown.numbers is not None:
            for what, number in shown.numbers.over_time.items():
                log(f"{name}/{what}", rerun.Scalars(number))

    def close(self) -> None:
        """Send the rest."""
        self._recording.disconnect()


class FoxgloveSink:
    """Topics `/sensor_N/image` (rgb8), `/sensor_N/indentation` (32FC1, meters, NaN where unknown), `/sensor_N/numbers`.

    `port` is the server's; 0 means any that is free. DataError: the extra `sinks` is not installed. GelformError: the port
    is taken.
    """

    def __init__(self, port: int = 8767) -> None:  # one without a known other use
        self._foxglove: Any = needed("foxglove", "sinks", "Sending to Foxglove")
        self._context = self._foxglove.Context()
        try:
            self._server = self._foxglove.start_server(
                name="gelform",
                host=HOST,
                port=port,
                context=self._context,
                message_backlog_size=16,  # for a slow client; the oldest are dropped (1024 would be 300 MB)
            )
        except Exception as problem:  # the extension's own class
            raise GelformError(
                f"Foxglove's server cannot listen on {HOST}:{port}: {problem}. Another program, perhaps another gelform "
                "live, uses the port. End it."
            ) from problem
        self._channels: dict[str, Any] = {}
        self.address = f"ws://{HOST}:{self._server.port}"
        self.how = f"Foxglove: open a connection to {self.address} (WebSocket)."

    def show(self, name: str, shown: ShownFrame) -> None:
        """Send a frame to the connected clients."""
        stamp = shown.frame.wall_time_ns
        self._image(f"/{name}/image", shown.image, "rgb8", stamp)
        if shown.result is not None:
            self._image(f"/{name}/indentation", indentation_m(shown.result), "32FC1", stamp)
        if shown.numbers is not None:
            channel = self._channel(f"/{name}/numbers", self._foxglove.Channel)
            channel.log(shown.numbers.over_time, log_time=stamp)

    def close(self) -> None:
        """Close the connections."""
        self._server.stop()

    def _image(self, topic: str, pixels: Any, encoding: str, stamp_ns: int) -> None:
        from foxglove import channels, messages

        seconds, nanoseconds = divmod(stamp_ns, 10**9)
        data = np.ascontiguousarray(pixels).tobytes()
        height, width = pixels.shape[:2]
        message = messages.RawImage(
            timestamp=messages.Timestamp(sec=seconds, nsec=nanoseconds),
            frame_id=topic.split("/")[1],
            width=width,
            height=height,
            encoding=encoding,
            step=len(data) // height,
            data=data,
        )
        self._channel(topic, channels.RawImageChannel).log(message, log_time=stamp_ns)

    def _channel(self, topic: str, make: Any) -> Any:
        if topic not in self._channels:
            self._channels[topic] = make(topic, context=self._context)
        return self._channels[topic]


SINKS: dict[str, Callable[[], Sink]] = {"rerun": RerunSink, "foxglove": FoxgloveSink}


def feed(hub: Hub, names: Sequence[str]) -> tuple[list[Feeder], list[str]]:
    """Start the sinks with those names; return the feeders, and a sentence for each that says where it shows.

    ValueError: a name is unknown. DataError: the sink's extra is not installed. GelformError: no viewer answers, or the
    port is in use. Then none is started.
    """
    unknown = [name for name in names if name not in SINKS]
    if unknown:
        raise ValueError(f"Expected sinks among {', '.join(SINKS)}, got {', '.join(unknown)}.")
    made: dict[str, Sink] = {}
    with ExitStack() as undone:
        for name in dict.fromkeys(names):
            made[name] = SINKS[name]()
            undone.callback(made[name].close)
        undone.pop_all()  # all started; they stay open
    return [Feeder(hub, sink, name) for name, sink in made.items()], [sink.how for sink in made.values()]
