"""gelform starter: a calibration of a sensor that nobody has pressed yet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from gelform.cli.console import say
from gelform.cli.options import STARTERS, MmPerPx, NewCalibration, Overwrite, Shown, listed, one_of
from gelform.cli.outputs import check_output


def starter(
    *,
    sensor: Annotated[str, Argument(metavar="SENSOR", help=f"Which make it is: {listed(STARTERS)}.")],
    background: Annotated[
        Path, Option(metavar="IMG|DIR", help="The unit's untouched gel: an image, or a folder of several.")
    ],
    output: NewCalibration,
    mm_per_px: MmPerPx = None,
    serial: Annotated[str | None, Option(metavar="TEXT", help="Serial number of the unit.")] = None,
    gel: Annotated[str | None, Option(metavar="TEXT", help="Which gel is on it.")] = None,
    overwrite: Overwrite = False,
    shown: Shown,
) -> None:
    """Make a calibration of a sensor that was never pressed.

    What other units of its make have shown is brought to this unit's light, which the image of its untouched gel tells.
    Its slopes, and depth with them, may be off by some percent, which every result says and has in its deviations.
    Presses of a ball make a better one: gelform calibrate.

    \b
    Examples:
      gelform starter gelsight-mini --background rest.png -o unit.npz
      gelform starter digit --background rest/ -o unit.npz --serial D20123
      gelform reconstruct frame.png -c unit.npz -o out
    """
    one_of(sensor, STARTERS, "SENSOR")
    check_output(output, overwrite=overwrite)
    from gelform.cli.sensor_images import starter_calibration

    calibration = starter_calibration(sensor, background, mm_per_px=mm_per_px, serial=serial, gel_id=gel)
    calibration.save(output, overwrite=overwrite)
    if not shown.silent:
        for finding in calibration.findings:
            say(f"note: {finding.message}")
    shown.say(f"Wrote {output}.")
    described = calibration.describe()
    kept = ("sensor_name", "serial", "gel_id", "image_shape", "mm_per_px", "settings", "digest")
    shown.json({"calibration": str(output), **{key: described[key] for key in kept}})
