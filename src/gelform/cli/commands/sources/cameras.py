"""gelform cameras: what is plugged in."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from gelform.cli.console import figure, print_json, say, show_table
from gelform.cli.options import Json, Quiet

if TYPE_CHECKING:
    from gelform.sensors.cameras.survey import Survey

SHOWN_MODES = 4


def cameras(
    measure: Annotated[
        bool,
        typer.Option("--measure/--no-measure", help="Open each camera for a second and count its frames."),
    ] = True,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """List the cameras that are plugged in: serial, name, path, modes and measured rate.

    \b
    Examples:
      gelform cameras
      gelform cameras --no-measure
      gelform cameras --json
    """
    from gelform.sensors.cameras.camera import NOTHING_THERE, cameras_there
    from gelform.sensors.cameras.survey import survey_of

    found = [survey_of(camera, measure=measure) for camera in cameras_there()]
    if as_json:
        print_json({"cameras": [_facts(one) for one in found]})
        return
    if not found:
        say(NOTHING_THERE, quiet)
        return
    rows = [
        (
            one.camera.name,
            one.camera.serial or "-",
            one.camera.path,
            one.camera.kind or "-",
            _modes(one),
            figure(one.rate_hz),
        )
        for one in found
    ]
    show_table("Cameras", ("name", "serial", "path", "sensor", "modes", "measured Hz"), rows, quiet=quiet)
    for one in found:
        if one.problem:
            say(f"{one.camera.path}: {one.problem}", quiet)


def _modes(one: Survey) -> str:
    shown = ", ".join(map(str, one.modes[:SHOWN_MODES]))
    more = len(one.modes) - SHOWN_MODES
    return (shown or "-") + (f" and {more} more (--json)" if more > 0 else "")


def _facts(one: Survey) -> dict[str, Any]:
    modes = [{"fourcc": mode.fourcc, "size_px": mode.shape, "rate_hz": mode.rate_hz} for mode in one.modes]
    camera = one.camera
    return {
        "name": camera.name,
        "serial": camera.serial,
        "path": camera.path,
        "by_path": camera.by_path,
        "usb_id": camera.usb_id,
        "sensor": camera.kind,
        "modes": modes,
        "rate_hz": one.rate_hz,
        "settings": one.settings,
        "problem": one.problem or None,
    }
