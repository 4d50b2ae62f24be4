"""gelform record: raw frames into a file; background and presses for a calibration."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gelform.cli.console import print_json, progress_shown, say
from gelform.cli.options import Json, MmPerPx, Quiet, Sensor, positive
from gelform.errors import DataError

if TYPE_CHECKING:
    from gelform.sensors.grabber import Grabber
    from gelform.sensors.recordings.record import RecordStats

BACKGROUND_FRAMES, FRESH_S = 10, 5.0


def record(
    source: Annotated[
        str,
        typer.Argument(metavar="[SOURCE]", help="Serial, name, path, URL, simulated; else the only camera."),
    ] = "",
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="FILE.mcap|DIR", help="A new file, or a new folder of images."
        ),
    ] = ...,  # type: ignore[assignment]
    seconds: Annotated[
        float | None, typer.Option(metavar="F", parser=positive, help="How long; else until Ctrl-C.")
    ] = None,
    frames: Annotated[int | None, typer.Option(metavar="N", min=1, help="How many frames.")] = None,
    presses: Annotated[
        bool,
        typer.Option("--presses", help="Take a background and presses with the space bar, for calibrate."),
    ] = False,
    ball_diameter_mm: Annotated[
        float | None, typer.Option(metavar="F", parser=positive, help="Of the ball that presses, mm.")
    ] = None,
    sensor: Sensor = None,
    mm_per_px: MmPerPx = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            "--calibration", "-c", metavar="CAL.npz", help="The calibration in use: its digest is kept."
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Of the camera: exposure, gain, white_balance, led_level, width, height, fps, fourcc.",
        ),
    ] = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Record a camera's frames as they come, with their times and the camera's settings.

    An MCAP file (extra `mcap`) holds ROS 2 messages, a folder PNG or JPEG files and frames.csv; both play again with
    every command that takes a SOURCE. With --presses, a folder that `gelform calibrate` reads.

    \b
    Examples:
      gelform record -o session.mcap
      gelform record simulated -o session --seconds 10
      gelform record D20123 -o session.mcap --set exposure=50 --set led_level=15 -c cal.npz
      gelform record http://192.168.0.7:8080/stream -o session.mcap
      gelform record D20123 --presses -o presses --ball-diameter-mm 6.35 --sensor digit
    """
    from gelform.sensors.source import open_source

    opened = partial(open_source, source, paced=True, settings=_settings(set_ or []) or None)
    if presses:
        _presses(opened, output, ball_diameter_mm, sensor, mm_per_px, quiet, as_json)
        return
    for given, option in (
        (ball_diameter_mm, "--ball-diameter-mm"),
        (sensor, "--sensor"),
        (mm_per_px, "--mm-per-px"),
    ):
        if given is not None:
            raise typer.BadParameter("is for --presses only.", param_hint=option)
    _frames(opened, output, seconds, frames, _digest(calibration), quiet, as_json)


def _frames(
    opened: Any,
    output: Path,
    seconds: float | None,
    frames: int | None,
    digest: str,
    quiet: bool,
    as_json: bool,
) -> None:
    from gelform.sensors.grabber import Grabber
    from gelform.sensors.recordings.record import KEPT_FRAMES, RecordStats, new_recording, record_frames

    stats = RecordStats(0, 0, 0, 0.0)
    with Grabber(opened, keep=KEPT_FRAMES) as grabber, progress_shown(quiet) as progress:
        recording = new_recording(output, grabber, calibration_digest=digest)
        say(f"Recording {grabber.name} into {output}{'' if seconds or frames else ', until Ctrl-C'}.", quiet)

        def going_on(now: RecordStats) -> bool:
            nonlocal stats
            stats = now
            done, total = (now.frames, frames) if frames else (round(now.duration_s), round(seconds or 0))
            progress(
                done,
                total,
                f"recording, {now.frames} frames" if grabber.state == "running" else grabber.state,
            )
            return True

        try:
            stats = record_frames(grabber, recording, seconds=seconds, frames=frames, going_on=going_on)
        except KeyboardInterrupt:  # the usual end of a recording
            pass
        finally:
            recording.close()
        reopened = grabber.stats.reopened
    _report(output, stats, reopened, quiet, as_json)


def _report(output: Path, stats: RecordStats, reopened: int, quiet: bool, as_json: bool) -> None:
    if stats.frames == 0:
        raise DataError(f"No frame came: {output} holds none. Look at the camera: gelform cameras.")
    missing = f", {stats.missing} missing" if stats.missing else ""
    again = f", the source was lost and back {reopened} times" if reopened else ""
    say(
        f"Wrote {output}: {stats.frames} frames in {stats.duration_s:.1f} s{missing}{again}, "
        f"{stats.written_bytes / 1e6:.1f} MB.",
        quiet,
    )
    if as_json:
        print_json({"recording": output, **vars(stats), "reopened": reopened})


def _presses(
    opened: Any,
    output: Path,
    ball_diameter_mm: float | None,
    sensor: str | None,
    mm_per_px: float | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Background and presses, a key each."""
    if ball_diameter_mm is None:
        raise typer.BadParameter(
            "needed with --presses: which ball presses?", param_hint="--ball-diameter-mm"
        )
    from gelform.calibration.presses.taken import TakenPresses
    from gelform.cli.keys import single_keys
    from gelform.sensors.grabber import Grabber

    with single_keys("record --presses") as key, Grabber(opened) as grabber:
        taken = TakenPresses(output, _sensor_settings(grabber, sensor, mm_per_px), ball_diameter_mm)
        say("Leave the gel untouched and press the space bar: the background. q ends.", quiet)
        while (pressed := key(0.2)) not in (" ", "q", ""):
            pass
        if pressed == " ":
            taken.take_background(_fresh(grabber, BACKGROUND_FRAMES))
            say(
                "Press the ball, hold it still, press the space bar; again elsewhere. u takes the last one out, q ends."
            )
            _take(taken, grabber, key, quiet)
    if taken.count == 0:
        raise DataError(
            f"No press was taken: {output} is no set of presses. Start again with another folder."
        )
    say(f"Wrote {output}: {taken.count} presses. Next: gelform calibrate {output} -o cal.npz", quiet)
    if as_json:
        print_json({"folder": output, "presses": taken.count, "ball_diameter_mm": ball_diameter_mm})


def _take(taken: Any, grabber: Grabber, key: Any, quiet: bool) -> None:
    """A press per space bar, until q or the end of the input."""
    while (pressed := key(0.2)) not in ("q", ""):
        if pressed == " ":
            try:
                name = taken.take_press(_fresh(grabber, 1)[0])
                say(f"{taken.count}: {name}", quiet)
            except DataError as problem:
                say(f"Not taken. {problem}", quiet)
        elif pressed == "u":
            name = taken.drop_last()
            say(f"Took out {name}." if name else "There is none to take out.", quiet)


def _fresh(grabber: Grabber, count: int) -> list[Any]:
    """Images of frames that come from now on."""
    images: list[Any] = []
    held = grabber.newest(-1, 0)
    after = held.index if held is not None else -1
    while len(images) < count:
        frame = grabber.newest(after, FRESH_S)
        if frame is None:
            raise DataError(f"No new frame within {FRESH_S:g} s: {grabber.reason or grabber.state}.")
        images.append(frame.image)
        after = frame.index
    return images


def _sensor_settings(grabber: Grabber, sensor: str | None, mm_per_px: float | None) -> Any:
    """What sensor.toml says: the known sensor's scale and view, the unit's serial, the camera's settings."""
    from gelform.sensors.files import SensorSettings
    from gelform.sensors.profiles import profile_named
    from gelform.view import View

    if sensor is None and mm_per_px is None:
        raise typer.BadParameter(
            "expected a known sensor or the width of a pixel: presses of a ball alone do not tell the scale.",
            param_hint="--sensor, --mm-per-px",
        )
    frame = _fresh(grabber, 1)[0]
    profile = profile_named(sensor) if sensor is not None else None
    view = View() if profile is None else profile.view((frame.shape[0], frame.shape[1]))
    sigma = profile.mm_per_px_sigma if profile is not None and mm_per_px is None else None
    return SensorSettings(
        profile.name if profile is not None else grabber.name,
        mm_per_px if mm_per_px is not None else profile.mm_per_px,  # type: ignore[union-attr]
        sigma,
        serial=grabber.serial or "",
        view=view,
        camera=grabber.settings,
    )


def _settings(pairs: list[str]) -> dict[str, float | str]:
    """exposure=50 ... as a table."""
    settings: dict[str, float | str] = {}
    for pair in pairs:
        name, separator, text = pair.partition("=")
        if not separator:
            raise typer.BadParameter(f"expected NAME=VALUE, got {pair!r}.", param_hint="--set")
        try:
            settings[name] = text if name == "fourcc" else float(text)
        except ValueError:
            raise typer.BadParameter(f"expected a number in {pair!r}.", param_hint="--set") from None
    if settings:
        from gelform.sensors.cameras.settings import check_settings

        try:
            return check_settings(settings)
        except ValueError as problem:
            raise typer.BadParameter(str(problem), param_hint="--set") from problem
    return settings


def _digest(calibration: Path | None) -> str:
    if calibration is None:
        return ""
    from gelform.calibration_file import load_calibration

    return load_calibration(calibration).digest
