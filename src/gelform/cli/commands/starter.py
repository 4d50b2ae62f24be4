"""gelform starter: a calibration without a press."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from gelform.cli.console import say
from gelform.cli.options import STARTERS, Bgr, MmPerPx, NewCalibration, Overwrite, ShownOption, listed, one_of
from gelform.cli.outputs import check_output


def starter(
    *,
    sensor: Annotated[str, Argument(metavar="SENSOR", help=f"Make of the sensor: {listed(STARTERS)}.")],
    background: Annotated[
        Path, Option(metavar="IMG|DIR", help="The unit's gel at rest: an image, or a folder of several.")
    ],
    output: NewCalibration,
    bgr: Bgr = False,
    mm_per_px: MmPerPx = None,
    serial: Annotated[str | None, Option(metavar="TEXT", help="Serial number of the unit.")] = None,
    gel: Annotated[str | None, Option(metavar="TEXT", help="Name of its gel.")] = None,
    overwrite: Overwrite = False,
    shown: ShownOption,
) -> None:
    """Make a calibration of a sensor without any press.

    A starter is a general calibration of a make. The image of this unit's gel at rest adapts it to the unit's light.
    Slopes and depth may be off by some percent. Every result says so, and its standard deviations include it.
    For a better calibration, press a ball: gelform calibrate.

    \b
    Examples:
      gelform starter gelsight-mini --background rest.png -o unit.npz
      gelform starter digit --background rest/ -o unit.npz --serial D20123
      gelform reconstruct frame.png -c unit.npz -o out
    """
    one_of(sensor, STARTERS, "SENSOR")
    check_output(output, overwrite=overwrite)
    from gelform.cli.sensor_images import starter_calibration

    calibration = starter_calibration(
        sensor, background, bgr=bgr, mm_per_px=mm_per_px, serial=serial, gel_id=gel
    )
    calibration.save(output, overwrite=overwrite)
    if not shown.silent:
        for finding in calibration.findings:
            say(f"note: {finding.message}")
    shown.say(f"Wrote {output}.")
    described = calibration.describe()
    kept = ("sensor_name", "serial", "gel_id", "image_shape", "mm_per_px", "settings", "digest")
    shown.json({"calibration": str(output), **{key: described[key] for key in kept}})
