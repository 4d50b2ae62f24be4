"""The application: the page's files, the session, the websocket, and the access to each.

Access to the server: checks of Host, Origin and token on every request and websocket; headers of answers.

A page of another site can make a browser send requests to this machine, but the browser writes Host and Origin itself. A
foreign name that was bound to this machine's address (DNS rebinding) shows in Host. A foreign page shows in Origin and in
Sec-Fetch-Site.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import ipaddress
from collections.abc import AsyncIterator, Iterable
from concurrent.futures import ThreadPoolExecutor
from http.cookies import CookieError, SimpleCookie
from importlib import resources
from pathlib import PurePosixPath
from typing import Any

from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from gelform import GelformError
from gelform.live.hub import Hub, page_named
from gelform.live.lists import shown_name
from gelform.live.web.client import POLICY, Client

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
    """The host names of the server, which `names` has besides this machine's own, and its token, if one is required.

    `any_address` accepts any address (not name) as a host, for a server that listens on all of them. An address cannot be
    bound to another machine, so this is safe.
    """

    def __init__(
        self, port: int, names: Iterable[str] = (), *, token: str | None = None, any_address: bool = False
    ) -> None:
        self.token = token
        self._port, self._any_address = port, any_address
        self._names = {name.lower() for name in ("127.0.0.1", "localhost", "::1", *names)}
        self.cookie = f"gelform_{port}"  # cookies do not distinguish ports

    def host_allowed(self, host: str) -> bool:
        """Whether a Host header names this server."""
        name, port = split_host(host)
        return port == self._port and (name in self._names or (self._any_address and _is_address(name)))

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

    def __init__(self, app: Any, access: Access, open_paths: Iterable[str]) -> None:
        self._app, self._access, self._open_paths = app, access, frozenset(open_paths)

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        async def with_headers(event: Any) -> None:
            if event["type"] == "http.response.start":
                own = list(event.get("headers", []))
                named = {name for name, _ in own}
                event = {**event, "headers": own + [one for one in HEADERS.items() if one[0] not in named]}
            await send(event)

        kind = scope["type"]
        refusal = self._refusal(scope) if kind in ("http", "websocket") else None
        if refusal is None:
            await self._app(scope, receive, with_headers)
        elif kind == "websocket":
            await send({"type": "websocket.close", "code": POLICY, "reason": ""})
        else:
            await PlainTextResponse(refusal[1], refusal[0])(scope, receive, with_headers)

    def _refusal(self, scope: Any) -> tuple[int, str] | None:
        """Status and text of a refusal; None if the request is allowed."""
        headers = Headers(scope=scope)
        host, origin = headers.get("host"), headers.get("origin")
        repeated = any(len(headers.getlist(name)) > 1 for name in ("host", "origin", "sec-fetch-site"))
        if repeated or host is None or not self._access.host_allowed(host):
            return 421, "This server does not answer to that host. Open the address that the terminal shows."
        own_origin = f"http://{host.lower()}"
        foreign = scope["type"] == "websocket" if origin is None else origin.lower() != own_origin
        # A user may follow a link to the page from anywhere, which only shows the page.
        visit = headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest") == "document"
        across = headers.get("sec-fetch-site", "none") not in ("none", "same-origin")
        if foreign or (across and not visit):
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


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


MAX_CLIENTS = 16  # pages open at once
MAX_BODY = 1024  # bytes of a request; a token has 43
# A calibration's report holds its style and its pictures itself, and no script.
REPORT_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}


def page_files() -> dict[str, bytes]:
    """The page's files by request path; nothing else from the disk is served."""
    found = {}
    folders = [("/", resources.files("gelform.live") / "page")]
    for place, one in folders:
        for entry in one.iterdir():
            if entry.is_dir():
                folders.append((f"{place}{entry.name}/", entry))
            elif PurePosixPath(entry.name).suffix in TYPES:
                found[place + entry.name] = entry.read_bytes()
    found["/"] = found.pop("/index.html")
    return found


def make_app(hub: Hub, access: Access) -> Any:
    """The application, behind the guard."""
    files = page_files()
    clients: set[Client] = set()
    threads = ThreadPoolExecutor(16, "action")

    async def page(request: Request) -> Response:
        name = request.url.path
        media_type = TYPES[PurePosixPath(name).suffix or ".html"]
        return Response(files[name], media_type=media_type, headers={"cache-control": "no-cache"})

    async def session(request: Request) -> Response:
        """Exchange the token for a cookie that scripts cannot read."""
        try:
            token = await asyncio.wait_for(_body(request), 5.0)
        except ClientDisconnect:
            return Response(status_code=400)
        except asyncio.TimeoutError:  # an alias of TimeoutError since Python 3.11
            return Response(status_code=408, headers={"connection": "close"})
        if token is None or not access.token_allowed(token):
            return Response("Wrong token. Open the address that the terminal shows.", 401)
        answer = Response(status_code=204, headers={"cache-control": "no-store"})
        if access.token is not None:
            answer.set_cookie(access.cookie, access.token, httponly=True, samesite="strict", path="/")
        return answer

    async def snapshot(request: Request) -> Response:
        number, name = _number(request), request.path_params["name"]
        saved_as, content = await asyncio.to_thread(hub.snapshots.file, number, name)
        headers = {"content-disposition": f'attachment; filename="{saved_as}"', "cache-control": "no-store"}
        return Response(content, media_type="application/octet-stream", headers=headers)

    async def recording(request: Request) -> Response:
        path = hub.recordings.file(_number(request))
        headers, name = {"cache-control": "no-store"}, shown_name(path.name)
        return FileResponse(path, media_type="application/octet-stream", filename=name, headers=headers)

    async def report(request: Request) -> Response:
        session = hub.guides.get(_number(request))
        if session is None or (made := session.guide.made) is None:
            return PlainTextResponse("There is no such report. It ends with the guide.", 404)
        headers = {"content-security-policy": REPORT_POLICY, "cache-control": "no-store"}
        return FileResponse(made.report_file, media_type=TYPES[".html"], headers=headers)

    async def gone(_: Request, problem: Exception) -> Response:
        return PlainTextResponse(str(problem), 404)

    async def socket(websocket: WebSocket) -> None:
        await websocket.accept()
        if len(clients) >= MAX_CLIENTS:
            await websocket.close(1013, "too many pages are open")  # RFC 6455, 7.4.1: try again later
            return
        client, name = Client(websocket, hub, threads), page_named(websocket.query_params.get("page", ""))
        clients.add(client)
        hub.pages.came(name)
        try:
            await client.run()
        finally:
            clients.discard(client)
            hub.pages.left(name)

    def wake() -> None:
        for client in tuple(clients):
            client.wake()

    async def tick() -> None:
        """Wake the clients at intervals, so that they get the state while no frames arrive."""
        while True:
            await asyncio.sleep(0.25)
            wake()

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        loop = asyncio.get_running_loop()

        def changed() -> None:
            with contextlib.suppress(RuntimeError):  # the loop was just closed; no client is left
                loop.call_soon_threadsafe(wake)

        hub.listen(changed)
        ticking = asyncio.create_task(tick())
        yield
        ticking.cancel()
        hub.close()
        threads.shutdown(wait=False, cancel_futures=True)

    routes = [
        *[Route(path, page, methods=["GET"]) for path in files],
        Route("/session", session, methods=["POST"]),
        Route("/snapshots/{number}/{name}", snapshot, methods=["GET"]),
        Route("/recordings/{number}", recording, methods=["GET"]),
        Route("/reports/{number}", report, methods=["GET"]),
        WebSocketRoute("/ws", socket),
    ]
    # The page's files are open: they contain nothing secret.
    app = Starlette(routes=routes, lifespan=lifespan, exception_handlers={GelformError: gone})
    return Guard(app, access, ("/session", *files))


def _number(request: Request) -> int:
    """The number in a path; -1, which nothing has, for any other text."""
    text = request.path_params["number"]
    return int(text) if text.isascii() and text.isdigit() and len(text) <= 9 else -1


async def _body(request: Request) -> str | None:
    """The body as text; None if it is longer than a token or not text."""
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > MAX_BODY:
            return None
    try:
        return body.decode("ascii")
    except UnicodeDecodeError:
        return None
