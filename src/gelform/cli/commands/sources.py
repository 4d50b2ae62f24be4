"""gelform cameras: the connected cameras; gelform record: frames into a file, or background and presses.

gelform live: the page that shows a sensor while it is touched.
"""

from __future__ import annotations

import os
import sys
import time
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import BadParameter, Option

import gelform
from gelform import DataError, GelformError
from gelform.cli import options
from gelform.cli.console import ShownOption, mistakes_in, print_json, say, show
from gelform.cli.options import argument, number, option, usage_errors
from gelform.errors import counted
from gelform.sensors.profiles import check_gel_width

if TYPE_CHECKING:
    from gelform.sensors.cameras import Camera
    from gelform.sensors.grabber import GrabberStats
    from gelform.sensors.record import RecordStats

MEASURED_S, FIRST_S = 1.0, 3.0  # s: time in which frames are counted; longest wait for the first frame
FRESH_S = 5.0  # s within which a frame must arrive


@contextmanager
def single_keys(purpose: str) -> Iterator[Callable[[], str]]:
    """Yield a function that waits for a key; it returns "" at the end of the input.

    The end of the block restores the terminal's settings. DataError, with the keys' purpose: standard input is no terminal.
    """
    if sys.stdin is None or not sys.stdin.isatty():
        raise DataError(
            f"{purpose} takes keys from a terminal, and standard input is none. Run it in a terminal."
        )
    if sys.platform == "win32":
        import msvcrt

        def read() -> str:
            while not msvcrt.kbhit():
                time.sleep(0.05)  # Ctrl-C interrupts the sleep, but not a wait for a key
            return str(msvcrt.getwch())

        yield read
        return
    import termios
    import tty

    handle = sys.stdin.fileno()
    before = termios.tcgetattr(handle)
    try:
        tty.setcbreak(handle)  # Ctrl-C still interrupts
        yield lambda: os.read(handle, 1).decode("latin-1")
    finally:
        termios.tcsetattr(handle, termios.TCSADRAIN, before)


def cameras(
    *,
    measure: Annotated[
        bool, Option("--measure/--no-measure", help="Open each camera for a second and count its frames.")
    ] = True,
    shown: ShownOption,
) -> None:
    """List the connected cameras.

    Shows serial number, name, path and measured rate of each.

    \b
    Examples:
      gelform cameras
      gelform cameras --no-measure
      gelform cameras --json
    """
    from gelform.sensors.cameras import NOTHING_THERE, cameras_there

    rows = [_camera_facts(camera, measure) for camera in cameras_there()]
    if shown.as_json:
        print_json({"cameras": rows})
        return
    if not rows:
        shown.say(NOTHING_THERE)
        return
    columns = ("name", "serial", "path", "sensor")
    shown.table("Cameras", {**dict(zip(columns, columns)), "rate_hz": "measured Hz"}, rows)
    for one in rows:
        if one["problem"]:
            shown.say(f"{one['path']}: {one['problem']}")


def _camera_facts(camera: Camera, measure: bool) -> dict[str, Any]:
    """A camera as it is listed; if measured, its settings and its rate over a second, or why it gives no frames."""
    facts: dict[str, Any] = {
        **{name: getattr(camera, name) for name in ("name", "serial", "path", "by_path", "usb_id")},
        "sensor": camera.kind,
        "rate_hz": None,
        "settings": {},
        "problem": None,
    }
    if not measure:
        return facts
    from gelform.sensors.cameras import UsbCamera

    try:
        with gelform.Grabber(lambda: UsbCamera(camera)) as grabber:
            facts["settings"] = grabber.settings
            if grabber.newest(-1, FIRST_S) is None:
                facts["problem"] = "it opens, but gives no frame"
            else:
                time.sleep(MEASURED_S)
                facts["rate_hz"] = grabber.stats.rate_hz
    except GelformError as problem:
        facts["problem"] = str(problem)
    return facts


@dataclass(frozen=True)
class PressesTaken:
    """Presses that are taken with the space bar, instead of a recording."""

    presses: Annotated[
        bool, Option("--presses", help="Take a background and presses with the space bar, for calibrate.")
    ] = False
    ball_diameter_mm: Annotated[float | None, number("Diameter of the ball, mm.", options.ball_diameter)] = (
        None
    )
    sensor: options.Sensor = None
    mm_per_px: options.MmPerPx = None


def record(
    *,
    source: Annotated[
        str, argument("[SOURCE]", "Serial, name, path, URL or simulated; else the only camera.")
    ] = "",
    output: Annotated[Path, options.output("FILE.mcap|DIR", "A new file; a new folder with --presses.")],
    seconds: options.Seconds = None,
    frames: Annotated[int | None, Option(metavar="N", min=1, help="Number of frames.")] = None,
    taken: PressesTaken,
    calibration: Annotated[
        Path | None, options.calibration("The calibration in use; its digest is recorded.")
    ] = None,
    set_: Annotated[
        list[str] | None,
        Option(
            "--set",
            metavar="NAME=VALUE",
            help="Camera setting: exposure, gain, white_balance, led_level, width, height, fps, fourcc. Of simulated: fps.",
        ),
    ] = None,
    reading: options.Reading,
    shown: ShownOption,
) -> None:
    """Record a camera's frames, or presses for a calibration.

    Keeps the frames unchanged, with their times and the camera's settings.

    The MCAP file (extra `mcap`) contains ROS 2 messages, and every command that takes a SOURCE plays it. With --presses, it
    writes a folder that `gelform calibrate` reads.

    \b
    Examples:
      gelform record -o session.mcap
      gelform record simulated -o session.mcap --seconds 10
      gelform record D20123 -o session.mcap --set exposure=50 --set led_level=15 -c cal.npz
      gelform record http://192.168.0.7:8080/stream -o session.mcap
      gelform record D20123 --presses -o presses --ball-diameter-mm 6.35 --sensor digit
    """
    camera = _camera_settings(set_ or [])
    opened = partial(gelform.open_source, source, paced=True, settings=camera or None, **vars(reading))
    if taken.presses:
        _presses(opened, output, taken, shown)
        return
    for name in ("ball_diameter_mm", "sensor", "mm_per_px"):
        if getattr(taken, name) is not None:
            raise BadParameter("is for --presses only.", param_hint=f"--{name.replace('_', '-')}")
    from gelform.sensors.record import why_missing

    digest = "" if calibration is None else gelform.load_calibration(calibration).digest
    stats, grabbed = _recorded(opened, output, seconds, frames, digest, shown)
    reopened = grabbed.reopened
    if stats.frames == 0:
        raise DataError(f"No frame arrived, so {output} holds none. Check the camera with gelform cameras.")
    missing = f", {stats.missing} missing" if stats.missing else ""
    again = f", the source was lost and reopened {reopened} times" if reopened else ""
    shown.say(
        f"Wrote {output}: {counted(stats.frames, 'frame')} in {stats.duration_s:.1f} s{missing}{again}, "
        f"{stats.written_bytes / 1e6:.1f} MB."
    )
    if stats.missing:
        shown.say(f"{'warning: ' if stats.has_gaps else ''}{why_missing(stats, grabbed.drops)}")
    shown.json({"recording": output, **vars(stats), "reopened": reopened, "lost_on_the_way": grabbed.drops})


def _recorded(
    opened: Any, output: Path, seconds: float | None, frames: int | None, digest: str, shown: ShownOption
) -> tuple[RecordStats, GrabberStats]:
    """The figures of a recording until its end or Ctrl-C, and those of the source."""
    from gelform.sensors.record import KEPT_FRAMES, RecordStats, new_recording, record_frames

    stats = RecordStats(0, 0, 0, 0.0)
    with gelform.Grabber(opened, keep=KEPT_FRAMES) as grabber, shown.progress() as progress:
        recording = new_recording(output, grabber, calibration_digest=digest)
        end = "" if seconds or frames else ", until Ctrl-C"
        shown.say(f"Recording {grabber.name} into {output}{end}.")

        def going_on(now: RecordStats) -> bool:
            nonlocal stats
            stats = now
            done, total, unit = now.frames, frames or 0, "frames"
            if seconds and not frames:
                done, total, unit = round(now.duration_s), round(seconds), "seconds"
            progress(done, total, f"recording, {unit}" if grabber.state == "running" else grabber.state)
            return True

        try:
            stats = record_frames(grabber, recording, seconds=seconds, frames=frames, going_on=going_on)
        except KeyboardInterrupt:  # the usual end of a recording
            pass
        finally:
            recording.close()
        return stats, grabber.stats


def _presses(opened: Any, output: Path, wanted: PressesTaken, shown: ShownOption) -> None:
    """Take background and presses, one key each."""
    if wanted.ball_diameter_mm is None:
        raise BadParameter(
            "needed with --presses: the diameter of the ball.", param_hint="--ball-diameter-mm"
        )
    from gelform.calibration.guide import TakenPresses

    with single_keys("record --presses") as key, gelform.Grabber(opened) as grabber:
        settings = _sensor_settings(grabber, wanted)
        taken = TakenPresses(output, settings, wanted.ball_diameter_mm)
        shown.say("Touch nothing and press the space bar to take the background image. q ends.")
        if _at_rest(grabber, key, taken, viewed=not settings.view.is_identity):
            say(
                "Press the ball, hold it still and press the space bar. Repeat elsewhere. u removes the last press, q ends."
            )
            while (pressed := key()) not in ("q", ""):
                if pressed == " ":
                    try:
                        name = taken.take_press(_fresh(grabber, 1)[0])
                        shown.say(f"{taken.count}: {name}")
                    except DataError as problem:
                        shown.say(f"Not taken. {problem}")
                elif pressed == "u":
                    removed = taken.drop_last()
                    shown.say(f"Removed {removed}." if removed else "There is no press to remove.")
    if taken.count == 0:
        raise DataError(
            f"No press was taken, so {output} is no press folder. Start again with another folder."
        )
    shown.say(f"Wrote {output}: {counted(taken.count, 'press')}. Next: gelform calibrate {output} -o cal.npz")
    shown.json({"folder": output, "presses": taken.count, "ball_diameter_mm": wanted.ball_diameter_mm})


def _space(key: Callable[[], str]) -> bool:
    """Wait for the space bar; False at q or the end of the input."""
    while (pressed := key()) not in (" ", "q", ""):
        pass
    return pressed == " "


def _at_rest(grabber: gelform.Grabber, key: Callable[[], str], taken: Any, viewed: bool) -> bool:
    """Take the gel at rest at a space bar, and at another if frames disagree or, once, seem touched; False at q."""
    from gelform.image.background import USUAL_FRAMES, surround_finding

    again = False
    while _space(key):
        try:
            rest = taken.take_background(_fresh(grabber, USUAL_FRAMES))
        except DataError as problem:
            say(f"Not taken. {problem} Press the space bar again.")
            continue
        if rest.touch is None or again:
            if finding := surround_finding(rest.background, "--crop {}", viewed=viewed):
                say(f"note: {finding.message}")
            return True
        again = True
        say(f"Not taken. {rest.touch.message} Press the space bar again; it is taken then.")
    return False


def _fresh(grabber: gelform.Grabber, count: int) -> list[Any]:
    """Images of frames that arrive from now on."""
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


def _sensor_settings(grabber: gelform.Grabber, wanted: PressesTaken) -> Any:
    """The content of sensor.toml: the known sensor's scale and view, the serial number, the camera's settings."""
    from gelform.calibration.guide import settings_of

    sensor, mm_per_px = wanted.sensor, wanted.mm_per_px
    if sensor is None and mm_per_px is None:
        raise BadParameter(
            "expected a known sensor or the width of a pixel: ball presses alone do not give the scale.",
            param_hint="--sensor, --mm-per-px",
        )
    height, width = _fresh(grabber, 1)[0].shape[:2]
    settings = settings_of(grabber, (height, width), sensor, mm_per_px)
    if mm_per_px is not None:
        with usage_errors("--mm-per-px"):
            doubt = check_gel_width(settings.view.shape or (height, width), mm_per_px, sensor)
        if doubt:
            say(f"note: {doubt}")
    return settings


def _camera_settings(pairs: list[str]) -> dict[str, float | str]:
    """Parse exposure=50 ... into a table."""
    settings: dict[str, float | str] = {}
    for pair in pairs:
        name, separator, text = pair.partition("=")
        if not separator:
            raise BadParameter(f"expected NAME=VALUE, got {pair!r}.", param_hint="--set")
        try:
            settings[name] = text if name == "fourcc" else float(text)
        except ValueError:
            raise BadParameter(f"expected a number in {pair!r}.", param_hint="--set") from None
    from gelform.sensors.cameras import check_settings

    with usage_errors("--set"):
        return check_settings(settings)


def live(
    sources: Annotated[
        list[str] | None,
        argument(
            "[SOURCE]...",
            "Serial, name, device, URL, video, folder, data set, or simulated[:SENSOR]. Default: simulated.",
        ),
    ] = None,
    calibration: Annotated[
        list[Path] | None,
        options.calibration("Calibration of each sensor, in order. Default: the newest of its serial."),
    ] = None,
    sensor: options.StarterSensor = None,
    *,
    reading: options.Reading,
    folder: Annotated[
        Path, option("DIR", "Folder of the offered calibrations and of new recordings.")
    ] = Path("."),
    host: Annotated[str, Option(help="Address to listen on; other machines need a token.")] = "127.0.0.1",
    port: Annotated[
        int | None, Option(min=1, max=65535, help="Port to listen on. Default: 8765, or the next free one.")
    ] = None,
    token: Annotated[
        bool, Option("--token", help="Require a token on this machine too, if others use it.")
    ] = False,
    rate: Annotated[
        float, Option(metavar="HZ", parser=options.positive, help="Frame rate of the simulated sensor.")
    ] = 60.0,
    sink: Annotated[
        list[str] | None, option("NAME", "Results also in rerun or foxglove; may be repeated.")
    ] = None,
    browser: Annotated[bool, Option("--open", help="Open the page in the browser.")] = False,
    quiet: options.Quiet = False,
) -> None:
    """Show depth in the browser, calibrate with a ball, record.

    Without SOURCE, the page shows a simulated sensor. For a GelSight Mini or a DIGIT without a calibration, it uses the
    starter of the make, once it has taken a background image. --sensor names the make of another camera.

    \b
    Examples:
      gelform live
      gelform live 2BKRXXXX -c mini.npz
      gelform live left right -c left.npz -c right.npz --port 8080
      gelform live http://robot:8080/stream --sensor digit
      gelform live session.mp4 -c mini.npz
      gelform live press_set --dataset observation.images.gel -c mini.npz
      gelform live --sink rerun
    """
    if sensor is not None:
        options.one_of(sensor, options.STARTERS, "--sensor")
    from gelform.live.actions import start
    from gelform.live.sinks import feed
    from gelform.live.web.server import listen

    server = listen(host, port, token=token)
    with mistakes_in("live"):
        hub = start(sources or ["simulated"], calibration or [], folder, rate, sensor, **vars(reading))
    try:
        with mistakes_in("--sink"):
            feeders, said = feed(hub, sink or [])
    except GelformError:
        hub.close()
        raise
    for _, level, text in hub.notices:
        say(f"warning: {text}" if level != "info" else text, quiet and level == "info")
    show(server.url)
    say("Open this address. Ctrl-C ends it.", quiet)
    for one in said:
        say(one, quiet)
    if browser:
        webbrowser.open(server.url)
    try:
        server.serve(hub)
    finally:
        for feeder in feeders:
            feeder.close()
        hub.close()
