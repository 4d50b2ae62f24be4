"""Access to the server: checks of Host, Origin and token on every request and websocket; headers of answers.

A page of another site can make a browser send requests to this machine, but the browser writes Host and Origin itself. A
foreign name that was bound to this machine's address (DNS rebinding) shows in Host. A foreign page shows in Origin and in
Sec-Fetch-Site.
"""

from __future__ import annotations

import hmac
import ipaddress
from collections.abc import Iterable
from http.cookies import CookieError, SimpleCookie
from typing import Any

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse

LOOPBACK = ("127.0.0.1", "localhost", "::1")  # names of this machine
DECIDING = ("host", "origin", "sec-fetch-site")  # headers that may occur only once
OPEN_PATHS = ("/session",)  # the page's files are open too: they contain nothing secret
HEADERS = {
    b"content-security-policy": b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
    b"connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    b"x-content-type-options": b"nosniff",
    b"x-frame-options": b"DENY",
    b"referrer-policy": b"no-referrer",
    b"cross-origin-opener-policy": b"same-origin",
    b"cross-origin-resource-policy": b"same-origin",
    b"permissions-policy": b"camera=(), microphone=(), geolocation=(), usb=()",
}


class Access:
    """The host names of the server, and its token.

    Parameters
    ----------
    port : of the server
    names : host names of the server besides this machine's own
    token : None if none is required
    any_address : whether any address (not name) is accepted as a host, for a server that listens on all of them. An address
        cannot be bound to another machine, so this is safe
    """

    def __init__(
        self, port: int, names: Iterable[str] = (), *, token: str | None = None, any_address: bool = False
    ) -> None:
        self.token = token
        self._port, self._any_address = port, any_address
        self._names = {name.lower() for name in (*LOOPBACK, *names)}
        self.cookie = f"gelform_{port}"  # cookies do not distinguish ports

    def host_allowed(self, host: str) -> bool:
        """Whether a Host header names this server."""
        name, port = split_host(host)
        if port != self._port:
            return False
        return name in self._names or (self._any_address and _is_address(name))

    def origin_allowed(self, origin: str, host: str) -> bool:
        """Whether an Origin header names the page that this server served under that host."""
        return origin.lower() == f"http://{host.lower()}"

    def token_allowed(self, given: str) -> bool:
        """Whether this is the token, in constant time."""
        return self.token is None or hmac.compare_digest(given.encode(), self.token.encode())

    def cookie_allowed(self, header: str) -> bool:
        """Whether a Cookie header has the token."""
        if self.token is None:
            return True
        try:
            morsel = SimpleCookie(header).get(self.cookie)
        except CookieError:
            return False
        return morsel is not None and self.token_allowed(morsel.value)


class Guard:
    """Refuses requests that `Access` does not allow, before the application; adds the headers that an answer lacks."""

    def __init__(self, app: Any, access: Access, open_paths: Iterable[str] = OPEN_PATHS) -> None:
        self._app, self._access, self._open_paths = app, access, frozenset(open_paths)

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        refusal = self._refusal(scope)
        if scope["type"] == "websocket":
            if refusal is None:
                await self._app(scope, receive, send)
            else:
                await send({"type": "websocket.close", "code": 1008, "reason": ""})
            return
        if refusal is None:
            await self._app(scope, receive, _with_headers(send))
        else:
            status, text = refusal
            await PlainTextResponse(text, status)(scope, receive, _with_headers(send))

    def _refusal(self, scope: Any) -> tuple[int, str] | None:
        """Status and text of a refusal; None if the request is allowed."""
        headers = Headers(scope=scope)
        host = headers.get("host")
        repeated = any(len(headers.getlist(name)) > 1 for name in DECIDING)
        if repeated or host is None or not self._access.host_allowed(host):
            return 421, "This server does not answer to that host. Open the address that the terminal shows."
        origin = headers.get("origin")
        if origin is None:
            foreign = scope["type"] == "websocket"
        else:
            foreign = not self._access.origin_allowed(origin, host)
        across = headers.get("sec-fetch-site", "none") not in ("none", "same-origin")
        if foreign or (across and not _is_visit(headers)):
            return 403, "Requests from other pages are refused."
        cookie = headers.get("cookie", "")
        if scope["path"] not in self._open_paths and not self._access.cookie_allowed(cookie):
            return 401, "Open the address that the terminal shows, with its token."
        return None


def split_host(host: str) -> tuple[str, int]:
    """Name and port of a Host header; port 80 if it states none, -1 if it is invalid."""
    name, colon, port = host.lower().rpartition(":")
    if not colon or host.endswith("]"):
        name, port = host.lower(), "80"
    name = name[1:-1] if name.startswith("[") and name.endswith("]") else name
    return name, int(port) if port.isascii() and port.isdigit() and len(port) <= 5 else -1


def _is_visit(headers: Headers) -> bool:
    """Whether a user follows a link to the page, which may come from anywhere and only shows the page."""
    return headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest") == "document"


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _with_headers(send: Any) -> Any:
    async def sent(event: Any) -> None:
        if event["type"] == "http.response.start":
            own = list(event.get("headers", []))
            named = {name for name, _ in own}
            event = {**event, "headers": own + [one for one in HEADERS.items() if one[0] not in named]}
        await send(event)

    return sent
