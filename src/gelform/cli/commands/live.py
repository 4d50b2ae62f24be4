"""gelform live: the page that shows a sensor while it is touched."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from gelform import GelformError
from gelform.cli import options
from gelform.cli.console import say, show
from gelform.cli.process import mistakes_in


def live(
    sources: Annotated[
        list[str] | None,
        Argument(
            metavar="[SOURCE]...",
            help="Serial, name, device, URL, video, folder, or simulated[:SENSOR]. Default: simulated.",
        ),
    ] = None,
    calibration: Annotated[
        list[Path] | None,
        options.calibration("Calibration of each sensor, in order. Default: the newest of its serial."),
    ] = None,
    sensor: options.StarterSensor = None,
    bgr: options.Bgr = False,
    folder: Annotated[
        Path, Option(metavar="DIR", help="Folder of the offered calibrations and of new recordings.")
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
        list[str] | None,
        Option(metavar="NAME", help="Also show the results in rerun or foxglove; may be repeated."),
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
      gelform live --sink rerun
    """
    if sensor is not None:
        options.one_of(sensor, options.STARTERS, "--sensor")
    from gelform.live.sinks import feed
    from gelform.live.start import Options, start
    from gelform.live.web.server import listen

    server = listen(host, port, token=token)
    with mistakes_in("live"):
        hub = start(Options(sources or ["simulated"], calibration or [], folder, rate, sensor, bgr))
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
