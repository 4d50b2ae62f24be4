"""A camera at an address: pictures pushed over HTTP (multipart/x-mixed-replace), the newest one taken."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from urllib.parse import urlsplit

from gelform.errors import SensorError, SourceLostError
from gelform.frames import Frame
from gelform.sensors.mjpeg.http_body import HttpBody
from gelform.sensors.mjpeg.jpeg import image_from_jpeg, jpeg_shape, reduction_of
from gelform.sensors.mjpeg.parts import PartSplitter

OPEN_S = 2.0  # for the connection and the first picture
STALL_S = 1.0  # a camera that sends nothing for so long is lost
MAX_TORN = 10  # torn pictures in a row after which the connection is made anew


class MjpegUrl:
    """The frames of an MJPEG address.

    Where several pictures have arrived, the last one is decoded and the others count as dropped; a torn picture
    (without its end, or not to be decoded) is left out and leaves a gap in the count too. Large pictures are decoded
    at reduced size (see `reduction_of`). `time_s` is when the picture had arrived.

    Parameters
    ----------
    url : http:// or https://
    timeout_s : for the connection

    Raises
    ------
    SensorError
        Nobody answers, the answer is no stream of pictures, or no picture comes within 2 s.
    """

    live = True
    serial: str | None = None
    rate_hz: float | None = None

    def __init__(self, url: str, *, timeout_s: float = OPEN_S) -> None:
        place = urlsplit(url)
        self.url = url
        self.name = f"{place.hostname}{f':{place.port}' if place.port else ''}{place.path}"
        self._body = HttpBody(url, timeout_s)
        self._closed = False
        self._arrived: list[bytes] = []
        with ExitStack() as undone:
            undone.callback(self._body.close)
            first = self._body.read(OPEN_S)
            self._splitter = PartSplitter(self._boundary(first))
            self._arrived = self._splitter.feed(first)
            self.settings = self._settings_of_first()
            undone.pop_all()  # it gives pictures: it stays open
        self._reduction = int(self.settings["reduced"])

    def __iter__(self) -> Iterator[Frame]:
        index, torn = -1, 0
        while not self._closed:
            parts, self._arrived = self._arrived or self._read(STALL_S), []
            time_s, wall_time_ns = time.monotonic(), time.time_ns()
            index += len(parts)
            image = image_from_jpeg(parts[-1], self._reduction) if parts else None
            if image is not None:
                torn = 0
                yield Frame(image, time_s, wall_time_ns, index, parts[-1])
            elif parts:
                torn += 1
            if torn > MAX_TORN:
                raise SourceLostError(f"{self.url} sent {torn} torn pictures in a row.")

    def close(self) -> None:
        """Close the connection."""
        self._closed = True
        self._body.close()

    def __enter__(self) -> MjpegUrl:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _boundary(self, first: bytes) -> str:
        """As the header names it; servers that name no kind of content begin with it."""
        kind = self._body.headers.get_content_type()
        boundary = self._body.headers.get_param("boundary")
        if kind.startswith("multipart/") and isinstance(boundary, str):
            return boundary
        if not first.startswith(b"--"):
            raise SensorError(
                f"Expected a stream of pictures (multipart/x-mixed-replace) at {self.url}, got {kind}. Give the "
                "address of the MJPEG stream itself, not of the page around it."
            )
        return first.partition(b"\r\n")[0].decode("latin-1")

    def _settings_of_first(self) -> dict[str, float | str]:
        """Wait for the first picture; its size and reduction."""
        until = time.monotonic() + OPEN_S
        while True:
            shape = next((shape for part in self._arrived if (shape := jpeg_shape(part))), None)
            if shape is not None:
                return {"width": shape[1], "height": shape[0], "reduced": reduction_of(shape)}
            if (left := until - time.monotonic()) <= 0:
                break
            self._arrived += self._read(left)
        raise SensorError(f"{self.url} answers, but sent no JPEG picture within {OPEN_S:g} s.")

    def _read(self, timeout_s: float) -> list[bytes]:
        data = self._body.read(timeout_s)
        if not data:
            raise SourceLostError(f"{self.url} ended the stream.")
        try:
            return self._splitter.feed(data)
        except ValueError as problem:
            raise SourceLostError(f"{self.url}: {problem}") from problem
