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
from typing import Any

from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from gelform.errors import GelformError
from gelform.live.hub import Hub, page_named
from gelform.live.lists import shown_name
from gelform.live.web.client import TOO_MANY, Client

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


MAX_CLIENTS = 16  # pages open at once
ACTING = 16  # threads that do the pages' actions
MAX_DIGITS = 9  # of a number in a path
MAX_BODY = 1024  # bytes of a request; a token has 43
BODY_S = 5.0  # s until a body has arrived
TICK_S = 0.25  # s between checks for news while no frames arrive
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
    folder = resources.files("gelform.live") / "page"
    found = {}
    folders = [("/", folder)]
    for place, one in folders:
        for entry in one.iterdir():
            if entry.is_dir():
                folders.append((f"{place}{entry.name}/", entry))
            elif any(entry.name.endswith(suffix) for suffix in TYPES):
                found[place + entry.name] = entry.read_bytes()
    found["/"] = found.pop("/index.html")
    return found


def make_app(hub: Hub, access: Access) -> Any:
    """The application, behind the guard."""
    files = page_files()
    clients: set[Client] = set()
    threads = ThreadPoolExecutor(ACTING, "action")

    async def page(request: Request) -> Response:
        name = request.url.path
        suffix = ".html" if name == "/" else name[name.rfind(".") :]
        headers = {"cache-control": "no-cache"}
        return Response(files[name], media_type=TYPES[suffix], headers=headers)

    async def session(request: Request) -> Response:
        """Exchange the token for a cookie that scripts cannot read."""
        try:
            given = await asyncio.wait_for(_body(request), BODY_S)
        except ClientDisconnect:
            return Response(status_code=400)
        except asyncio.TimeoutError:  # an alias of TimeoutError since Python 3.11
            return Response(status_code=408, headers={"connection": "close"})
        if given is None or not access.token_allowed(given):
            return Response("Wrong token. Open the address that the terminal shows.", 401)
        answer = Response(status_code=204, headers={"cache-control": "no-store"})
        if access.token is not None:
            answer.set_cookie(access.cookie, access.token, httponly=True, samesite="strict", path="/")
        return answer

    async def snapshot(request: Request) -> Response:
        number, name = _number(request), request.path_params["name"]
        try:
            saved_as, content = await asyncio.to_thread(hub.snapshots.file, number, name)
        except GelformError as problem:
            return Response(str(problem), 404, media_type="text/plain")
        headers = {"content-disposition": f'attachment; filename="{saved_as}"', "cache-control": "no-store"}
        return Response(content, media_type="application/octet-stream", headers=headers)

    async def recording(request: Request) -> Response:
        try:
            path = hub.recordings.file(_number(request))
        except GelformError as problem:
            return Response(str(problem), 404, media_type="text/plain")
        headers = {"cache-control": "no-store"}
        name = shown_name(path.name)
        return FileResponse(path, media_type="application/octet-stream", filename=name, headers=headers)

    async def report(request: Request) -> Response:
        session = hub.guides.get(_number(request))
        if session is None or (made := session.guide.made) is None:
            return Response("There is no such report. It ends with the guide.", 404, media_type="text/plain")
        headers = {"content-security-policy": REPORT_POLICY, "cache-control": "no-store"}
        return FileResponse(made.report_file, media_type=TYPES[".html"], headers=headers)

    async def socket(websocket: WebSocket) -> None:
        await websocket.accept()
        if len(clients) >= MAX_CLIENTS:
            await websocket.close(TOO_MANY, "too many pages are open")
            return
        client, name = Client(websocket, hub, threads), page_named(websocket.query_params.get("page", ""))
        clients.add(client)
        hub.pages.came(name)
        try:
            await client.run()
        finally:
            clients.discard(client)
            hub.pages.left(name)

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        loop = asyncio.get_running_loop()
        hub.listen(lambda: _call(loop, wake))
        ticking = asyncio.create_task(_tick(wake))
        yield
        ticking.cancel()
        hub.close()
        threads.shutdown(wait=False, cancel_futures=True)

    def wake() -> None:
        for client in tuple(clients):
            client.wake()

    routes = [
        *[Route(path, page, methods=["GET"]) for path in files],
        Route("/session", session, methods=["POST"]),
        Route("/snapshots/{number}/{name}", snapshot, methods=["GET"]),
        Route("/recordings/{number}", recording, methods=["GET"]),
        Route("/reports/{number}", report, methods=["GET"]),
        WebSocketRoute("/ws", socket),
    ]
    return Guard(Starlette(routes=routes, lifespan=lifespan), access, (*OPEN_PATHS, *files))


def _number(request: Request) -> int:
    """The number in a path; -1, which nothing has, for any other text."""
    text = request.path_params["number"]
    return int(text) if text.isascii() and text.isdigit() and len(text) <= MAX_DIGITS else -1


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


async def _tick(wake: Any) -> None:
    """Wake the clients at intervals, so that they get the state while no frames arrive."""
    while True:
        await asyncio.sleep(TICK_S)
        wake()


def _call(loop: asyncio.AbstractEventLoop, function: Any) -> None:
    with contextlib.suppress(RuntimeError):  # the loop was just closed; no client is left
        loop.call_soon_threadsafe(function)
