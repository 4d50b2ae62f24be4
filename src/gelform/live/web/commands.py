"""Messages of the page: each is checked completely, then does one thing. A new button is one line in `COMMANDS`."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gelform.errors import GelformError
from gelform.live import actions
from gelform.live.hub import Hub

MAX_BYTES, MAX_TEXT = 16 * 1024, 200  # bytes of a message; letters of a name


class MessageError(GelformError):
    """A client's message is unknown or malformed; the fault is the client's."""


def station(value: Any) -> int:
    """Check the number of a sensor."""
    return _small(value, "station")


def camera(value: Any) -> int:
    """Check the number of a camera in the list of devices."""
    return _small(value, "camera")


def text(value: Any) -> str:
    """Check a name from a list that the server made."""
    if not isinstance(value, str) or len(value) > MAX_TEXT or not value.isprintable():
        raise MessageError(f"Expected a name of at most {MAX_TEXT} letters.")
    return value


def number(value: Any) -> float:
    """Check a finite number."""
    return _within(value, 1e6)


def time_ms(value: Any) -> float:
    """Check a time of the page's clock."""
    return _within(value, 1e15)


def yes_no(value: Any) -> bool:
    """Check True or False."""
    if not isinstance(value, bool):
        raise MessageError("Expected true or false.")
    return value


@dataclass(frozen=True)
class Command:
    """An action on a station, which may return an answer, and the check of each of its fields."""

    act: Callable[..., dict[str, Any] | None]
    fields: dict[str, Callable[[Any], Any]]


COMMANDS = {
    "background": Command(actions.take_background, {"station": station}),
    "starter": Command(actions.take_starter, {"station": station, "sensor": text}),
    "undo_background": Command(actions.undo_background, {"station": station}),
    "zero": Command(actions.set_zero, {"station": station}),
    "calibration": Command(actions.use_calibration, {"station": station, "name": text}),
    "solver": Command(actions.use_solver, {"station": station, "name": text}),
    "guide_start": Command(
        actions.guide_start,
        {"station": station, "ball_diameter_mm": number, "profile": text, "mm_per_px": number},
    ),
    "guide_fit": Command(actions.guide_fit, {"station": station}),
    "guide_use": Command(actions.guide_use, {"station": station}),
    "guide_more": Command(actions.guide_more, {"station": station}),
    "guide_stop": Command(actions.guide_stop, {"station": station}),
    "record": Command(actions.record, {"station": station, "on": yes_no, "page": text}),
    "snapshot": Command(actions.snapshot, {"station": station}),
    "motion": Command(actions.follow_motion, {"station": station, "on": yes_no}),
    "pause": Command(actions.pause, {"station": station, "paused": yes_no}),
    "camera": Command(actions.set_camera, {"station": station, "name": text, "value": number}),
    "show": Command(actions.show_camera, {"station": station, "camera": camera}),
    "open": Command(actions.open_recording, {"station": station, "name": text}),
    "play": Command(actions.play, {"station": station, "playing": yes_no}),
    "seek": Command(actions.seek, {"station": station, "frame": number}),
    "step": Command(actions.step, {"station": station, "by": number}),
    "speed": Command(actions.speed, {"station": station, "speed": number}),
    "loop": Command(actions.loop, {"station": station, "loop": yes_no}),
    "share": Command(actions.share, {"station": station}),
    "press": Command(actions.press, {"station": station, "x_px": number, "y_px": number}),
}


def parsed(message: str) -> dict[str, Any]:
    """A message's fields: a JSON object with a word `do`.

    Raises
    ------
    MessageError
        The message is too long, no JSON, no object, or lacks `do`.
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


def done(hub: Hub, content: dict[str, Any]) -> dict[str, Any] | None:
    """Do the action of a message; return its answer, if there is one.

    Raises
    ------
    MessageError
        The command is unknown, or fields are missing, unknown or of the wrong type.
    GelformError
        The action failed, or another one of the same station lasts; the text is for the user.
    """
    command = COMMANDS.get(content["do"])
    if command is None:
        raise MessageError("Expected one of the known commands.")
    given = {name: value for name, value in content.items() if name != "do"}
    if given.keys() != command.fields.keys():
        raise MessageError(f"Expected the fields {', '.join(command.fields)}.")
    checked = {name: check(given[name]) for name, check in command.fields.items()}
    with hub.turn(checked["station"]):
        return command.act(hub, **checked)


def _within(value: Any, most: float) -> float:
    if type(value) not in (int, float) or not abs(value) <= most:
        raise MessageError("Expected a finite number.")
    return float(value)


def _small(value: Any, name: str) -> int:
    if type(value) is not int or not 0 <= value < 64:
        raise MessageError(f"Expected {name} as a small whole number.")
    return value


def _no_constant(name: str) -> None:
    raise ValueError(f"{name} is no JSON")
