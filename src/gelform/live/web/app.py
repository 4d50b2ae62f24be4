"""The application: the page's files, the session, the websocket."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from importlib import resources
from typing import Any

from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from gelform.errors import GelformError
from gelform.live.hub import Hub, page_named
from gelform.live.lists import shown_name
from gelform.live.web.client import TOO_MANY, Client
from gelform.live.web.guard import OPEN_PATHS, Access, Guard

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
