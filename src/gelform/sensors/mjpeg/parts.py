"""A multipart stream cut into its parts (RFC 2046, section 5.1), each of them one picture."""

from __future__ import annotations

import re

MAX_PART_BYTES = 64 * 2**20
MAX_HEADER_BYTES = 16 * 2**10
_LENGTH = re.compile(rb"content-length:\s*(\d+)", re.IGNORECASE)


class PartSplitter:
    """Collects bytes and gives the parts that are complete.

    A part ends where its Content-Length says, else at the next boundary. Where a part is not followed by a boundary,
    it is given all the same, and what comes up to the next boundary is passed over.

    Parameters
    ----------
    boundary : as the stream's content type names it; servers disagree about the dashes before it
    """

    def __init__(self, boundary: str) -> None:
        self._boundary = b"--" + boundary.strip().strip('"').lstrip("-").encode("latin-1")
        self._bytes = bytearray()
        self._searched = 0  # bytes of the buffer that hold no boundary

    def feed(self, data: bytes) -> list[bytes]:
        """Parts that these bytes complete.

        Raises
        ------
        ValueError
            More bytes without a boundary than a picture has: this is no such stream.
        """
        self._bytes += data
        parts = []
        while (part := self._next()) is not None:
            parts.append(part)
        if len(self._bytes) > MAX_PART_BYTES:
            raise ValueError(
                f"Expected a picture of at most {MAX_PART_BYTES >> 20} MB, got more without an end."
            )
        return parts

    def _next(self) -> bytes | None:
        """The first part, cut off the buffer; None while it is not complete."""
        start = self._bytes.find(self._boundary)
        if start < 0:
            return None
        head_end = self._bytes.find(b"\r\n\r\n", start, start + MAX_HEADER_BYTES)
        if head_end < 0:
            return None
        body = head_end + 4
        length = _LENGTH.search(self._bytes, start, head_end)
        if length is not None:
            end = body + int(length.group(1))
            return self._cut(body, end) if len(self._bytes) >= end else None
        end = self._bytes.find(self._boundary, max(body, self._searched))
        if end < 0:
            self._searched = max(body, len(self._bytes) - len(self._boundary))
            return None
        return self._cut(body, end).rstrip(b"\r\n-")

    def _cut(self, start: int, end: int) -> bytes:
        part = bytes(memoryview(self._bytes)[start:end])
        del self._bytes[:end]
        self._searched = 0
        return part
