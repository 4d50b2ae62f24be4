"""The body of an HTTP response as it arrives, without waiting for more than there is."""

from __future__ import annotations

import base64
import contextlib
import select
import socket
import ssl
from email.message import Message
from http.client import parse_headers
from io import BytesIO
from urllib.parse import SplitResult, unquote, urlsplit

from gelform.errors import SensorError, SourceLostError

MAX_HEADER_BYTES = 64 * 2**10
RECEIVE_BYTES = 2**20


class HttpBody:
    """A GET request whose answer goes on for ever.

    Parameters
    ----------
    url : http:// or https://, with user:password@ where the camera wants them
    timeout_s : for the connection and the answer's header

    Raises
    ------
    SensorError
        Nobody answers there, or the answer is not 200.
    """

    def __init__(self, url: str, timeout_s: float) -> None:
        self.url = url
        place = urlsplit(url)
        self._socket = _connected(place, url, timeout_s)
        try:
            self._socket.sendall(_request(place))
            self.headers, rest = self._answer()
        except OSError as problem:
            self._socket.close()
            raise SensorError(f"{url} does not answer: {_said(problem)}.") from problem
        except SensorError:
            self._socket.close()
            raise
        chunked = "chunked" in (self.headers.get("Transfer-Encoding") or "").lower()
        self._dechunk = Dechunker() if chunked else None
        self._first = rest

    def read(self, timeout_s: float) -> bytes:
        """All bytes that are there, after waiting for the first; empty where the body has ended.

        Raises
        ------
        SourceLostError
            The connection is gone, or nothing came for `timeout_s`.
        """
        if self._dechunk is not None and self._dechunk.ended:
            return b""
        received, self._first = bytearray(self._first), b""
        try:
            if not received:
                self._socket.settimeout(timeout_s)
                received += self._socket.recv(RECEIVE_BYTES)
            while received and len(received) < 64 * RECEIVE_BYTES and self._is_ready():
                more = self._socket.recv(RECEIVE_BYTES)
                if not more:
                    break
                received += more
        except TimeoutError:
            raise SourceLostError(f"{self.url} sent nothing for {timeout_s:g} s.") from None
        except (OSError, ValueError) as problem:  # ValueError: closed meanwhile
            raise SourceLostError(f"The connection to {self.url} is lost: {_said(problem)}.") from problem
        if self._dechunk is None or not received:
            return bytes(received)
        return self._dechunk.feed(bytes(received)) or self._after_empty(timeout_s)

    def close(self) -> None:
        """Close the connection; a reading thread wakes up."""
        with contextlib.suppress(OSError):  # it is closed already
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _after_empty(self, timeout_s: float) -> bytes:
        """What comes after bytes that were a chunk's frame only."""
        assert self._dechunk is not None
        return b"" if self._dechunk.ended else self.read(timeout_s)

    def _is_ready(self) -> bool:
        if isinstance(self._socket, ssl.SSLSocket) and self._socket.pending():
            return True
        return bool(select.select([self._socket], [], [], 0)[0])

    def _answer(self) -> tuple[Message, bytes]:
        """The header of the answer, and the bytes of the body that came with it."""
        received = bytearray()
        while b"\r\n\r\n" not in received and len(received) < MAX_HEADER_BYTES:
            more = self._socket.recv(RECEIVE_BYTES)
            if not more:
                raise SensorError(f"{self.url} closed the connection without an answer.")
            received += more
        head, _, rest = bytes(received).partition(b"\r\n\r\n")
        status_line, _, fields = head.partition(b"\r\n")
        words = status_line.decode("latin-1").split(None, 2)
        if len(words) < 2 or not words[0].startswith("HTTP/"):
            raise SensorError(f"{self.url} does not speak HTTP.")
        headers = parse_headers(BytesIO(fields + b"\r\n\r\n"))
        if words[1] != "200":
            raise SensorError(f"{self.url} answers {' '.join(words[1:])}.{_remedy(words[1], headers)}")
        return headers, rest


class Dechunker:
    """Takes the chunks' sizes out of a chunked body (RFC 9112, section 7.1)."""

    def __init__(self) -> None:
        self.ended = False
        self._bytes = bytearray()
        self._left = 0  # of the chunk that is being read

    def feed(self, data: bytes) -> bytes:
        """The content of these bytes."""
        self._bytes += data
        content = []
        while self._bytes and not self.ended:
            if self._left == 0 and not self._next_chunk():
                break
            taken = bytes(self._bytes[: self._left])
            del self._bytes[: len(taken)]
            self._left -= len(taken)
            content.append(taken)
        return b"".join(content)

    def _next_chunk(self) -> bool:
        """Read a size line, and the line end of the chunk before it; False where it is not all there."""
        start = 2 if self._bytes.startswith(b"\r\n") else 0
        end = self._bytes.find(b"\r\n", start)
        if end < 0:
            return False
        text = bytes(self._bytes[start:end]).split(b";")[0].strip()
        try:
            self._left = int(text, 16)
        except ValueError:
            raise SourceLostError(f"Expected the size of a chunk, got {text[:20]!r}: torn data.") from None
        del self._bytes[: end + 2]
        self.ended = self._left == 0
        return not self.ended


def _connected(place: SplitResult, url: str, timeout_s: float) -> socket.socket:
    try:
        port = place.port or (443 if place.scheme == "https" else 80)
    except ValueError as problem:
        raise SensorError(f"Expected an address like http://host:8080/stream, got {url}.") from problem
    if not place.hostname:
        raise SensorError(f"Expected an address like http://host:8080/stream, got {url}.")
    try:
        plain = socket.create_connection((place.hostname, port), timeout_s)
        if plain.getsockname() == plain.getpeername():  # TCP may connect a port of this machine to itself:
            plain.close()  # the server, when it comes, could not have it
            raise ConnectionRefusedError("nobody listens")
        if place.scheme != "https":
            return plain
        return ssl.create_default_context().wrap_socket(plain, server_hostname=place.hostname)
    except OSError as problem:
        raise SensorError(
            f"Nothing answers at {place.hostname}:{port}: {_said(problem)}. Is the camera's server running, and "
            "the address right?"
        ) from problem


def _request(place: SplitResult) -> bytes:
    path = (place.path or "/") + (f"?{place.query}" if place.query else "")
    lines = [f"GET {path} HTTP/1.1", f"Host: {place.netloc.rpartition('@')[2]}", "Accept: */*"]
    if place.username is not None:
        pair = f"{unquote(place.username)}:{unquote(place.password or '')}"
        lines.append(f"Authorization: Basic {base64.b64encode(pair.encode()).decode()}")
    return ("\r\n".join([*lines, "Connection: close"]) + "\r\n\r\n").encode("latin-1")


def _remedy(status: str, headers: Message) -> str:
    if status == "401":
        return " Put the camera's user and password before the host: http://user:password@host/..."
    moved = headers.get("Location")
    return f" It has moved to {moved}: give that address." if moved else " Check the path of the address."


def _said(problem: BaseException) -> str:
    if isinstance(problem, TimeoutError):
        return "no answer in time"
    return str(getattr(problem, "strerror", None) or problem or type(problem).__name__)
