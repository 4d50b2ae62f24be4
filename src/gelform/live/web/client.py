"""One browser: its messages, each checked completely, and the newest frame when it is ready for one.

Frames never wait in a queue. The page sends one credit per drawn picture, at once or shortly before it draws the next
one. Without credit nothing is sent, and newer frames replace older ones. A slow or stalled page therefore affects only
itself.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from gelform import GelformError
from gelform.live import actions
from gelform.live.hub import Hub, sentence_for_page
from gelform.live.shown import ENCODINGS, PLANES, ShownFrame, message
from gelform.live.station import Station
from gelform.sensors.playback import Player

MAX_BYTES, MAX_TEXT = 16 * 1024, 200  # bytes of a message; letters of a name


class MessageError(GelformError):
    """A client's message is unknown or malformed; the fault is the client's."""


def small(value: Any) -> int:
    """Check the number of a sensor, or of a camera in the list of devices."""
    if type(value) is not int or not 0 <= value < 64:
        raise MessageError("Expected a station or a camera as a small whole number.")
    return value


def text(value: Any) -> str:
    """Check a name from a list that the server made."""
    if not isinstance(value, str) or len(value) > MAX_TEXT or not value.isprintable():
        raise MessageError(f"Expected a name of at most {MAX_TEXT} letters.")
    return value


def number(value: Any, most: float = 1e6) -> float:
    """Check a finite number."""
    if type(value) not in (int, float) or not abs(value) <= most:
        raise MessageError("Expected a finite number.")
    return float(value)


def four_numbers(value: Any) -> list[float]:
    """Check a list of four finite numbers."""
    if not isinstance(value, list) or len(value) != 4:
        raise MessageError("Expected four numbers.")
    return [number(one) for one in value]


def yes_no(value: Any) -> bool:
    """Check True or False."""
    if not isinstance(value, bool):
        raise MessageError("Expected true or false.")
    return value


# A button's action on a station, and the check of each field of its message besides the station's number. An action
# may return an answer.
COMMANDS: dict[str, tuple[Callable[..., dict[str, Any] | None], dict[str, Callable[[Any], Any]]]] = {
    "background": (actions.take_background, {}),
    "starter": (actions.take_starter, {"sensor": text}),
    "undo_background": (actions.undo_background, {}),
    "zero": (actions.set_zero, {}),
    "calibration": (actions.use_calibration, {"name": text}),
    "guide_start": (actions.guide_start, {"ball_diameter_mm": number, "profile": text, "mm_per_px": number}),
    "guide_click": (actions.guide_click, {"x_px": number, "y_px": number}),
    "guide_fit": (actions.guide_fit, {}),
    "guide_use": (actions.guide_use, {}),
    "guide_more": (actions.guide_more, {}),
    "guide_stop": (actions.guide_stop, {}),
    "record": (actions.record, {"on": yes_no, "page": text}),
    "snapshot": (actions.snapshot, {}),
    "motion": (actions.follow_motion, {"on": yes_no}),
    "pause": (actions.pause, {"paused": yes_no}),
    "camera": (actions.set_camera, {"name": text, "value": number}),
    "show": (actions.show_camera, {"camera": small}),
    "open": (actions.open_recording, {"name": text}),
    "play": (actions.on_player(Player.play), {"playing": yes_no}),
    "seek": (actions.on_player(Player.seek), {"frame": number}),
    "step": (actions.on_player(Player.step), {"by": number}),
    "speed": (actions.on_player(Player.set_speed), {"speed": number}),
    "loop": (actions.on_player(Player.loop), {"loop": yes_no}),
    "share": (actions.share, {}),
    "measure": (actions.measure_line, {"ends_px": four_numbers}),
    "press": (actions.press, {"x_px": number, "y_px": number}),
}


def parsed(message: str) -> dict[str, Any]:
    """A message's fields: a JSON object with a word `do`.

    MessageError: the message is too long, no JSON, no object, or lacks `do`.
    """
    if len(message) > MAX_BYTES:
        raise MessageError(f"Expected a message of at most {MAX_BYTES} bytes.")
    try:
        content = json.loads(message, parse_constant=_no_constant)
    except (ValueError, RecursionError) as problem:
        raise MessageError("Expected a message of JSON.") from problem
    if not isinstance(content, dict) or not isinstance(content.get("do"), str):
        raise MessageError('Expected an object with a word "do".')
    return content


def _no_constant(name: str) -> None:
    raise ValueError(f"{name} is no JSON")


def done(hub: Hub, content: dict[str, Any]) -> dict[str, Any] | None:
    """Do the action of a message, and announce that; return its answer, if there is one.

    MessageError: the command is unknown, or fields are missing, unknown or of the wrong type. GelformError, ValueError: the
    action failed, or another one of the same station lasts; the text is for the user.
    """
    if content["do"] not in COMMANDS:
        raise MessageError("Expected one of the known commands.")
    act, checks = COMMANDS[content["do"]]
    if content.keys() != {"do", "station", *checks}:
        raise MessageError(f"Expected the fields {', '.join(('station', *checks))}.")
    checked = {name: check(content[name]) for name, check in checks.items()}
    with hub.turn(small(content["station"])) as station:
        answer = act(hub, station, **checked)
    hub.changed()
    return answer


STATE_EVERY_S = 0.25  # s between messages about the state
MESSAGES_PER_S, MESSAGES_AT_ONCE = 200.0, 400.0  # limits per client; a page at 60 frames/s sends 70
# Rows for the curves per frame: the newest singly, and as many groups of earlier ones.
MAX_NUMBERS, MAX_OLDER = 240, 1200
POLICY = 1008  # close code: RFC 6455, 7.4.1


@dataclass
class Watched:
    """The selection of a client: stations, planes and encoding; of the stations in `few` only the surface."""

    stations: list[int] = field(default_factory=lambda: [0])
    planes: list[str] = field(default_factory=lambda: ["image"])
    encoding: str = "small"
    few: list[int] = field(default_factory=list)


class Client:
    """A page's websocket, already accepted.

    `threads` do the actions, apart from those that encode frames: an action may wait for frames.
    """

    def __init__(self, socket: WebSocket, hub: Hub, threads: Executor) -> None:
        self._socket, self._hub, self._threads = socket, hub, threads
        self._may_act = asyncio.Semaphore(8)  # actions at once; further messages wait
        self._wake = asyncio.Event()
        self._watched = Watched()
        self._credit = 0
        self._sent: dict[int, int] = {}
        self._turns: dict[int, float] = {}
        self._replies: deque[dict[str, Any]] = deque(maxlen=32)
        self._state_at = 0.0
        self._noticed = hub.notices[-1][0] if hub.notices else 0
        self._allowance, self._heard_at = MESSAGES_AT_ONCE, time.monotonic()

    def wake(self) -> None:
        """Check for something to send."""
        self._wake.set()

    async def run(self) -> None:
        """Exchange messages until the page closes."""
        tasks = [asyncio.create_task(self._send_all()), asyncio.create_task(self._receive_all())]
        self.wake()
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    # -- to the page -------------------------------------------------------------------------------------------------

    async def _send_all(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._replies:
                await self._send_words(self._replies.popleft())
            now = time.monotonic()
            if now - self._state_at >= STATE_EVERY_S:
                self._state_at = now
                facts = self._hub.facts(self._noticed)
                if facts["notices"]:
                    self._noticed = facts["notices"][-1][0]
                await self._send_words({"kind": "state", **facts})
            # Longest wait first: with little credit each station gets its turn.
            for number in sorted(self._watched.stations, key=lambda one: self._turns.get(one, 0.0)):
                if self._credit > 0 and number < len(self._hub.stations):
                    await self._send_frame(self._hub.stations[number])

    async def _send_words(self, content: dict[str, Any]) -> None:
        await self._socket.send_text(json.dumps(content, separators=(",", ":"), allow_nan=False))

    async def _send_frame(self, station: Station) -> None:
        shown, before = station.newest, self._sent.get(station.number, 0)
        if shown is None or shown.serial <= before:
            return
        self._credit -= 1
        self._turns[station.number] = time.monotonic()
        self._sent[station.number] = shown.serial
        data = await asyncio.to_thread(_encoded, station, shown, before, self._watched)
        await self._socket.send_bytes(data)

    # -- from the page -----------------------------------------------------------------------------------------------

    async def _receive_all(self) -> None:
        while True:
            try:
                text = await self._socket.receive_text()
            except (WebSocketDisconnect, KeyError, RuntimeError):  # closed, or bytes instead of text
                return
            now = time.monotonic()
            earned = MESSAGES_PER_S * (now - self._heard_at)
            self._allowance, self._heard_at = min(MESSAGES_AT_ONCE, self._allowance + earned) - 1, now
            try:
                if self._allowance <= 0:
                    raise MessageError("too many messages")
                await self._heard(parsed(text))
            except MessageError as problem:
                await self._socket.close(POLICY, str(problem)[:120])
                return

    async def _heard(self, content: dict[str, Any]) -> None:
        what = content["do"]
        if what == "credit":
            self._credit = min(4 * len(self._watched.stations), self._credit + 1)
        elif what == "watch":
            self._watched = watched_from(content)
            self._sent.clear()
        elif what == "ping":
            sent = number(content.get("sent"), 1e15)  # ms, of the page's clock
            self._replies.append({"kind": "pong", "sent": sent, "now_s": time.monotonic()})
        else:
            await self._may_act.acquire()
            acting = asyncio.get_running_loop().create_task(self._act(content))
            acting.add_done_callback(lambda _: self._may_act.release())
            await asyncio.sleep(0)
        self.wake()

    async def _act(self, content: dict[str, Any]) -> None:
        """Do a button's action; the answer reports its success or error."""
        reply = {"kind": "done", "do": content["do"], "problem": ""}
        try:
            loop = asyncio.get_running_loop()
            answer = await loop.run_in_executor(self._threads, done, self._hub, content)
            if answer is not None:
                self._replies.append(answer)
        except MessageError as problem:
            await self._socket.close(POLICY, str(problem)[:120])
            return
        except Exception as problem:  # each click gets its answer
            reply["problem"] = sentence_for_page(problem)
        self._replies.append(reply)
        self._state_at = 0.0
        self.wake()


def watched_from(content: dict[str, Any]) -> Watched:
    """The selection in a message; MessageError for values outside the lists."""
    stations, planes, few = content.get("stations"), content.get("planes"), content.get("few", [])
    if not isinstance(stations, list) or not isinstance(planes, list) or len(stations) > 16:
        raise MessageError("Expected stations and planes as lists.")
    if content.get("encoding") not in ENCODINGS or not all(plane in PLANES for plane in planes):
        raise MessageError("Expected planes and an encoding that are known.")
    if not isinstance(few, list) or len(few) > 16:
        raise MessageError("Expected few as a list.")
    numbers = list(dict.fromkeys(map(small, stations)))
    return Watched(numbers, list(dict.fromkeys(planes)), content["encoding"], [small(one) for one in few])


def _encoded(station: Station, shown: ShownFrame, before: int, watched: Watched) -> bytes:
    numbers = thinned(station.numbers_since(before))
    header = {**shown.header(), "station": station.number, "numbers": [row[1:] for row in numbers]}
    planes = ("depth", "unknown") if station.number in watched.few else watched.planes
    return message(header, shown.planes(planes, watched.encoding))


def thinned(rows: Sequence[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """Rows (serial, time_s, peak, ...) for the curves: the newest ones, and the deepest of each group of earlier ones."""
    newest, older = list(rows[-MAX_NUMBERS:]), rows[:-MAX_NUMBERS]
    size = -(-len(older) // MAX_OLDER) or 1
    deepest = [max(older[k : k + size], key=itemgetter(2)) for k in range(0, len(older), size)]
    return deepest + newest
