"""Connections of the server: one without a request ends in seconds, and gives way where there are many."""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

# Until a connection has sent a whole request; browsers keep idle connections for the next one.
REQUEST_S = 5.0


class HttpConnection(H11Protocol):
    """A connection that is closed if it sends no whole request in time.

    Where silent connections are half of what the server takes, a new one ends the one that has been silent the longest, so
    that they keep nobody out.
    """

    silent_since_s = 0.0

    @property
    def is_silent(self) -> bool:
        """Whether it is open and has no request that is being answered."""
        return not self.transport.is_closing() and (self.cycle is None or self.cycle.response_complete)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        silent = [one for one in self.connections if isinstance(one, HttpConnection) and one.is_silent]
        if self.limit_concurrency is not None and len(silent) >= self.limit_concurrency // 2:
            min(silent, key=lambda one: one.silent_since_s).transport.abort()
        super().connection_made(transport)
        self.silent_since_s = self.loop.time()
        self._look()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        self.silent_since_s = self.loop.time()
        super().on_response_complete()

    def _look(self) -> None:
        if self.transport.is_closing() or self.transport.get_protocol() is not self:  # a websocket has it now
            return
        if self.is_silent and self.loop.time() - self.silent_since_s >= REQUEST_S:
            self.transport.abort()
        else:
            self.loop.call_later(0.5, self._look)


class WebsocketConnection(WebSocketsSansIOProtocol):
    """A websocket whose messages of invalid UTF-8 are empty ones for the application, which refuses them."""

    frames: list[Any]

    def send_receive_event_to_app(self) -> None:
        """Hand over a whole message."""
        if self.curr_msg_data_type == "text":
            try:
                b"".join(self.frames).decode()
            except UnicodeDecodeError:
                self.frames = [b""]
        super().send_receive_event_to_app()
