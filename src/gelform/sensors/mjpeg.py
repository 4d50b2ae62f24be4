"""A network camera: JPEG pictures over HTTP (multipart/x-mixed-replace); the newest one is decoded."""

from __future__ import annotations

import base64
import contextlib
import re
import select
import socket
import ssl
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from http import HTTPStatus
from http.client import HTTP_PORT, HTTPS_PORT, HTTPConnection, HTTPException, HTTPResponse, RemoteDisconnected
from urllib.parse import SplitResult, unquote, urlsplit

from gelform.arrays import MIB
from gelform.errors import SensorError, SourceLostError
from gelform.image.view import Frame
from gelform.sensors.pictures import MAX_TORN, image_from_jpeg, jpeg_shape, reduction_of
from gelform.sensors.playback import Closing, FrameReader

OPEN_S = 2.0  # s, timeout for the connection and the first picture
STALL_S = 1.0  # s without data until the camera counts as lost
PICTURE_S = 5.0  # s without a whole picture, whatever else arrives: a large one over a slow network takes 3
RECEIVE_BYTES = MIB  # of one call
MAX_PART_BYTES, MAX_PART_HEADER_BYTES = 64 * MIB, 16 * 1024  # limits of a picture and its header
_SECRET = re.compile(r"([?&][^=&]*(?:pass|pwd|token|key|secret)[^=&]*=)[^&#]*", re.IGNORECASE)
_LENGTH = re.compile(rb"content-length:\s*(\d{1,12})", re.IGNORECASE)


def shown_address(spec: str) -> str:
    """A source as it may be shown: an address without its user, its password and the secrets in its query."""
    scheme, mark, rest = spec.partition("://")
    if scheme.lower() not in ("http", "https") or not mark:
        return spec
    place = re.split(r"[/?#]", rest, maxsplit=1)[0]
    is_whole = "@" in place or re.fullmatch(r"[^:]*|.*:\d*|\[.*\]", place)
    secret = place.rfind("@") if is_whole else rest.rfind("@")  # a password with a / that was not quoted
    return f"{scheme}://" + _SECRET.sub(r"\1...", rest[secret + 1 :])


class MjpegUrl(Closing, FrameReader):
    """The frames of an MJPEG address, http:// or https://.

    If several pictures have arrived, the last one is decoded and the others count as dropped. A torn picture (without its
    end, or not decodable) is skipped and leaves a gap in the count too. Large pictures are decoded at reduced size (see
    `reduction_of`). `time_s` is the arrival time of the picture.

    SensorError: the host does not answer, the answer is no stream of pictures, or no picture arrives within 2 s.
    """

    live = True
    serial: str | None = None
    rate_hz: float | None = None

    def __init__(self, url: str, *, timeout_s: float = OPEN_S) -> None:
        self.url = shown_address(url)
        self._body = HttpBody(url, timeout_s)
        place = urlsplit(url)
        self.name = f"{place.hostname}{f':{place.port}' if place.port else ''}{place.path}"
        self._closed = False
        self._arrived: list[bytes] = []
        with ExitStack() as undone:
            undone.callback(self._body.close)
            first = self._body.read(OPEN_S)
            self._splitter = PartSplitter(self._boundary(first))
            self._arrived = self._parts(first)
            until = time.monotonic() + OPEN_S
            while (shape := next(filter(None, map(jpeg_shape, self._arrived)), None)) is None:
                if time.monotonic() >= until:
                    raise SensorError(f"{self.url} answers, but sent no JPEG picture within {OPEN_S:g} s.")
                self._arrived = self._read(OPEN_S)  # the time that is left may be too short for a piece
            undone.pop_all()  # it sends pictures; the connection stays open
        self._reduction = reduction_of(shape)
        self.settings: dict[str, float | str] = {
            "width": shape[1],
            "height": shape[0],
            "reduced": self._reduction,
        }

    def _frames(self) -> Iterator[Frame]:
        index, torn, picture_s = -1, 0, time.monotonic()
        while not self._closed:
            parts, self._arrived = self._arrived or self._read(STALL_S), []
            time_s, wall_time_ns = time.monotonic(), time.time_ns()
            index += len(parts)
            image = image_from_jpeg(parts[-1], self._reduction) if parts else None
            if image is not None:
                torn = 0
                yield Frame(image, time_s, wall_time_ns, index, parts[-1])
                picture_s = time.monotonic()
            elif parts:
                torn += 1
            if time.monotonic() - picture_s > PICTURE_S:
                raise SourceLostError(f"{self.url} sent no whole picture for {PICTURE_S:g} s.")
            if torn > MAX_TORN:
                raise SourceLostError(f"{self.url} sent {torn} torn pictures in a row.")

    def close(self) -> None:
        """Close the connection."""
        self._closed = True
        self._body.close()

    def _boundary(self, first: bytes) -> str:
        """The boundary from the header; without one, from the first line of the body."""
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

    def _read(self, timeout_s: float) -> list[bytes]:
        data = self._body.read(timeout_s)
        if not data:
            raise SourceLostError(f"{self.url} ended the stream.")
        return self._parts(data)

    def _parts(self, data: bytes) -> list[bytes]:
        try:
            return self._splitter.feed(data)
        except ValueError as problem:
            raise SourceLostError(f"{self.url}: {problem}") from problem


class HttpBody:
    """The body of a GET request whose answer never ends, as it arrives.

    The address has user:password@ if the camera requires them. The connection and the answer's header have a timeout, s.

    SensorError: the host does not answer, or the status is not 200.
    """

    def __init__(self, url: str, timeout_s: float) -> None:
        self.url = shown_address(url)
        expected = f"Expected an address like http://host:8080/stream, got {self.url}."
        try:
            place = urlsplit(url)
            port = place.port or (HTTPS_PORT if place.scheme == "https" else HTTP_PORT)
        except ValueError:
            raise SensorError(expected) from None
        if not place.hostname:
            raise SensorError(expected)
        self._socket = _connected(place, port, timeout_s)
        with ExitStack() as undone:
            undone.callback(self._socket.close)
            # A header that arrives byte by byte never reaches the timeout of a byte.
            until = time.monotonic() + 2 * timeout_s
            ending = threading.Timer(2 * timeout_s, _shut, [self._socket])
            ending.start()
            try:
                self._response = _answer_to(place, self._socket, self.url)
            except SensorError:
                if time.monotonic() < until:
                    raise
            finally:
                ending.cancel()
            if time.monotonic() >= until:  # whatever the ended connection made of it, such as a reset
                raise SensorError(
                    f"{self.url} did not finish its answer's header within {2 * timeout_s:g} s."
                )
            undone.pop_all()  # it answers; the connection stays open
        self.headers = self._response.headers
        self._dechunk = Dechunker() if self._response.chunked else None
        # Read raw bytes: the library's reader of chunks waits for the size of the next chunk, and a stream has no length.
        self._response.chunked, self._response.length = False, None

    def read(self, timeout_s: float) -> bytes:
        """Wait for data and return all bytes available; empty at the end of the body.

        SourceLostError: the connection is lost, or no content arrived for `timeout_s`.
        """
        until = time.monotonic() + timeout_s
        while self._dechunk is None or not self._dechunk.ended:
            if time.monotonic() > until:
                raise SourceLostError(f"{self.url} sent sizes of chunks and no content for {timeout_s:g} s.")
            received = self._received(timeout_s)
            content = received if self._dechunk is None else self._dechunk.feed(received)
            if content or not received:
                return content
        return b""

    def _received(self, timeout_s: float) -> bytes:
        if self._response.isclosed():  # closed by the server, at the end
            return b""
        try:
            self._socket.settimeout(timeout_s)
            received = bytearray(self._response.read1(RECEIVE_BYTES))
            while received and len(received) < 8 * RECEIVE_BYTES:
                decrypted = isinstance(self._socket, ssl.SSLSocket) and self._socket.pending()
                is_ready = decrypted or select.select([self._socket], [], [], 0)[0]
                more = self._response.read1(RECEIVE_BYTES) if is_ready else b""
                if not more:
                    break
                received += more
            return bytes(received)
        except TimeoutError:
            raise SourceLostError(f"{self.url} sent nothing for {timeout_s:g} s.") from None
        except (OSError, ValueError) as problem:  # ValueError: another thread closed it
            raise SourceLostError(f"The connection to {self.url} is lost: {_said(problem)}.") from problem

    def close(self) -> None:
        """Close the connection; this wakes a reading thread."""
        _shut(self._socket)
        self._socket.close()
        self._response.close()  # it also holds the socket


def _shut(connected: socket.socket) -> None:
    """End a connection in both directions, which wakes its readers."""
    with contextlib.suppress(OSError):  # already closed
        connected.shutdown(socket.SHUT_RDWR)


class Dechunker:
    """Removes the chunk sizes from a chunked body (RFC 9112, section 7.1)."""

    def __init__(self) -> None:
        self.ended = False
        self._bytes = bytearray()
        self._left = 0  # bytes left of the current chunk

    def feed(self, data: bytes) -> bytes:
        """The content of these bytes."""
        self._bytes += data
        content = []
        while self._bytes and not self.ended:
            if self._left == 0:  # a size line, and the line end of the previous chunk
                start = 2 if self._bytes.startswith(b"\r\n") else 0
                end = self._bytes.find(b"\r\n", start)
                if end < 0 and len(self._bytes) > 1024:
                    raise SourceLostError(
                        f"Expected the size of a chunk, got {len(self._bytes)} bytes without one: torn data."
                    )
                if end < 0:  # incomplete
                    break
                text = bytes(self._bytes[start:end]).split(b";")[0].strip()
                if not re.fullmatch(rb"[0-9A-Fa-f]+", text):
                    raise SourceLostError(f"Expected the size of a chunk, got {text[:20]!r}: torn data.")
                self._left = int(text, 16)
                del self._bytes[: end + 2]
                self.ended = self._left == 0
            taken = bytes(self._bytes[: self._left])
            del self._bytes[: len(taken)]
            self._left -= len(taken)
            content.append(taken)
        return b"".join(content)


def _connected(place: SplitResult, port: int, timeout_s: float) -> socket.socket:
    try:
        plain = socket.create_connection((place.hostname, port), timeout_s)
        if plain.getsockname() == plain.getpeername():  # TCP may connect a local port to itself:
            plain.close()  # the server could not bind the port later
            raise ConnectionRefusedError("no program listens")
        if place.scheme != "https":
            return plain
        return ssl.create_default_context().wrap_socket(plain, server_hostname=place.hostname)
    except OSError as problem:
        raise SensorError(
            f"Nothing answers at {place.hostname}:{port}: {_said(problem)}. Is the camera's server running, and "
            "the address right?"
        ) from problem


def _answer_to(place: SplitResult, connected: socket.socket, url: str) -> HTTPResponse:
    """The answer, with its header read."""
    headers = {"Host": place.netloc.rpartition("@")[2], "Accept": "*/*", "Connection": "close"}
    if place.username is not None:
        pair = f"{unquote(place.username)}:{unquote(place.password or '')}"
        headers["Authorization"] = f"Basic {base64.b64encode(pair.encode()).decode()}"
    connection = HTTPConnection(str(place.hostname))
    connection.sock = connected
    try:
        path = (place.path or "/") + (f"?{place.query}" if place.query else "")
        connection.request("GET", path, headers=headers)
        response = connection.getresponse()
    except RemoteDisconnected as problem:
        raise SensorError(f"{url} closed the connection without an answer.") from problem
    except HTTPException as problem:
        raise SensorError(f"{url} does not speak HTTP.") from problem
    except OSError as problem:
        raise SensorError(f"{url} does not answer: {_said(problem)}.") from problem
    if response.status != HTTPStatus.OK:
        response.close()
        remedy = "Check the path of the address."
        moved = shown_address(response.headers.get("Location") or "")
        if response.status == HTTPStatus.UNAUTHORIZED:
            remedy = "Put the camera's user and password before the host: http://user:password@host/..."
        elif moved:
            remedy = f"It has moved to {moved}: give that address."
        raise SensorError(f"{url} answers {response.status} {response.reason}. {remedy}")
    return response


def _said(problem: BaseException) -> str:
    if isinstance(problem, TimeoutError):
        return "no answer in time"
    return str(getattr(problem, "strerror", None) or problem or type(problem).__name__)


class PartSplitter:
    """Collects bytes and returns the complete parts.

    A part ends where its Content-Length says, or at a boundary before that, because some servers state lengths that are too
    large. Without a length it ends at the next boundary. A part without a boundary after it is returned too; bytes up to the
    next boundary are skipped. The boundary is that of the stream's content type; servers differ in the dashes before it.
    """

    def __init__(self, boundary: str) -> None:
        self._boundary = b"--" + boundary.strip().strip('"').lstrip("-").encode("latin-1")
        # After a line's end, or after the end of a JPEG: servers that state lengths may leave out the line's end.
        self._after = re.compile(rb"(?:\r?\n|(?<=\xff\xd9))-*" + re.escape(self._boundary))
        self._bytes = bytearray()
        self._searched = 0  # bytes of the buffer known to hold no boundary

    def feed(self, data: bytes) -> list[bytes]:
        """Parts that these bytes complete.

        ValueError: the bytes without a boundary exceed a picture's size, or a header has no end: this is no such stream.
        """
        self._bytes += data
        parts = []
        while (part := self._next()) is not None:
            parts.append(part)
        if len(self._bytes) > MAX_PART_BYTES:
            raise ValueError(
                f"Expected a picture of at most {MAX_PART_BYTES // MIB} MB, got more without an end."
            )
        return parts

    def _next(self) -> bytes | None:
        """Remove the first part from the buffer; None if it is incomplete."""
        start = self._bytes.find(self._boundary)
        if start < 0:
            return None
        head_end = self._bytes.find(b"\r\n\r\n", start, start + MAX_PART_HEADER_BYTES)
        if head_end < 0:
            if len(self._bytes) - start >= MAX_PART_HEADER_BYTES:
                raise ValueError(
                    f"Expected a part's header of at most {MAX_PART_HEADER_BYTES} bytes, got more."
                )
            return None
        later = self._bytes.rfind(self._boundary, start + 1, head_end)
        if later >= 0:  # the header of an earlier part has no end
            del self._bytes[:later]
            return self._next()
        body = head_end + 4
        stated = _LENGTH.search(self._bytes, start, head_end)
        whole = len(self._bytes) if stated is None else body + int(stated.group(1))
        after = self._after.search(self._bytes, max(body, self._searched), whole)
        if after is not None or (stated is not None and len(self._bytes) >= whole):
            end = whole if after is None else after.start()
            part = bytes(memoryview(self._bytes)[body:end])
            del self._bytes[:end]
            self._searched = 0
            return part
        # 16 bytes before a boundary's own two dashes: the line end, and dashes that servers add.
        self._searched = max(body, len(self._bytes) - len(self._boundary) - 16)
        return None
