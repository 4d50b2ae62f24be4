"""Starts the server: a free port, a token for access from other machines, the address to open."""

from __future__ import annotations

import errno
import ipaddress
import secrets
import socket
from dataclasses import dataclass
from typing import Any

from gelform.errors import GelformError, needed
from gelform.live.hub import Hub

MAX_CONNECTIONS = 128  # 16 pages with their files
ALL_ADDRESSES = ("0.0.0.0", "::")


@dataclass(frozen=True)
class Server:
    """A server that already listens; it answers once `serve` is called."""

    url: str  # to open, with the token if there is one
    token: str | None  # None if only this machine has access
    _socket: socket.socket
    _host: str

    @property
    def address(self) -> str:
        """Host and port, as in a Host header."""
        host, port = self._socket.getsockname()[:2]
        return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"

    def serve(self, hub: Hub) -> None:
        """Answer until interrupted."""
        self.run(self.uvicorn_of(hub))

    def run(self, uvicorn: Any) -> None:
        """Answer until that server is told to exit."""
        uvicorn.run(sockets=[self._socket])

    def close(self) -> None:
        """Release the port."""
        self._socket.close()

    def uvicorn_of(self, hub: Hub) -> Any:
        """A uvicorn server of the hub's application, with its limits."""
        import uvicorn

        from gelform.live.web.app import Access, make_app
        from gelform.live.web.connections import HttpConnection, WebsocketConnection

        port = self._socket.getsockname()[1]
        anywhere = self._host in ALL_ADDRESSES
        names = [socket.gethostname()] if anywhere else [self._host]
        access = Access(port, names, token=self.token, any_address=anywhere)
        config = uvicorn.Config(
            make_app(hub, access),
            log_level="warning",
            access_log=False,
            server_header=False,
            http=HttpConnection,
            ws=WebsocketConnection,
            ws_max_size=64 * 1024,  # bytes of a page's message
            ws_ping_interval=10.0,
            ws_ping_timeout=20.0,
            ws_per_message_deflate=False,
            limit_concurrency=MAX_CONNECTIONS,
            h11_max_incomplete_event_size=16 * 1024,
            timeout_graceful_shutdown=1,
        )
        return uvicorn.Server(config)


def listen(host: str = "127.0.0.1", port: int | None = None, *, token: bool = False) -> Server:
    """Listen on a port, by default on 8765 or the next free one; other machines than this one need a token.

    `token` requires one on this machine too, if others use it. GelformError: the extra is not installed, the port is in
    use, or the host does not exist.
    """
    check_extra()
    taken = _bound(host, port)
    secret = secrets.token_urlsafe(32) if token or not is_loopback(host) else None
    shown = socket.gethostname() if host in ALL_ADDRESSES else host
    address = f"[{shown}]" if ":" in shown else shown
    fragment = "" if secret is None else f"#token={secret}"
    return Server(f"http://{address}:{taken.getsockname()[1]}/{fragment}", secret, taken, host)


def check_extra() -> None:
    """Raise DataError, naming the extra, if the server's packages are not installed."""
    for package in ("starlette", "uvicorn", "websockets"):
        needed(package, "live", "The live page")


def is_loopback(host: str) -> bool:
    """Whether a host means only this machine."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _bound(host: str, port: int | None) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for one in [port] if port is not None else [*range(8765, 8785), 0]:
        try:
            taken = socket.create_server((host, one), family=family, backlog=64)
            taken.setblocking(False)
            return taken
        except OSError as problem:
            if problem.errno not in (errno.EADDRINUSE, errno.EACCES):
                why = (problem.strerror or str(problem)).partition(" (while")[0]
                raise GelformError(
                    f"Cannot listen on {host}: {why}. Give an address of this machine."
                ) from problem
            if port is not None:
                raise GelformError(
                    f"Port {port} is in use or not allowed. Choose another: --port {port + 1}, or leave it out."
                ) from problem
    raise AssertionError("port 0 is always free")
