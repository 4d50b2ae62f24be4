"""gelform import: another package's calibration to one of gelform's."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gelform.cli.console import print_json, say
from gelform.cli.failures import mistakes_in
from gelform.cli.options import Background, Json, MmPerPx, Overwrite, Quiet, one_of
from gelform.cli.result_names import check_output
from gelform.cli.tables import PACKAGES, listed


def import_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The package's calibration file.")],
    package: Annotated[
        str, typer.Option("--from", metavar="PACKAGE", help=f"Whose file it is: {listed(PACKAGES)}.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="CAL.npz", help="The calibration to write.")
    ],
    background: Background = None,
    mm_per_px: MmPerPx = None,
    position: Annotated[
        str | None,
        typer.Option(
            metavar="zeros|true",
            help="For gsrobotics: zeros as its program feeds its network, or the true positions.",
        ),
    ] = None,
    flip_depth: Annotated[
        bool, typer.Option("--flip-depth", help="For lut: its surface falls where pressed.")
    ] = False,
    name: Annotated[str | None, typer.Option(metavar="NAME", help="Name of the sensor.")] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Import a calibration that another package made.

    Networks of gs_sdk (nnmodel.pth), gsrobotics (nnmini.pt) and its browser port, Taxim's polycalib.npz, and
    look-up tables (table_smooth.npy). Nothing in FILE is executed. The background is an image of the untouched
    gel, cropped and sized as that package's images are. Without --mm-per-px, results are gradients and depth in
    pixels.

    \b
    Examples:
      gelform import nnmodel.pth --from gs_sdk --background rest.png --mm-per-px 0.0634 -o cal.npz
      gelform import nnmini.pt --from gsrobotics --position zeros --background rest.png -o cal.npz
      gelform import polycalib.npz --from taxim --background rest.png -o cal.npz
      gelform import table_smooth.npy --from lut --flip-depth --background rest.png -o cal.npz
    """
    one_of(package, PACKAGES, "--from")
    if background is None:
        raise typer.BadParameter(
            "needed: an image of the untouched gel; these files hold none.", param_hint="--background"
        )
    from gelform.importers.calibrations import import_calibration
    from gelform.sensors.files import read_image

    check_output(output, overwrite=overwrite)
    with mistakes_in(file):
        calibration = import_calibration(
            file,
            package,
            background=read_image(background),
            mm_per_px=mm_per_px,
            position=position,
            flip_depth=flip_depth,
            sensor_name=name,
        )
    calibration.save(output, overwrite=overwrite)
    if calibration.mm_per_px is None:
        say("note: without --mm-per-px the scale is unknown: results will be in pixels, not mm.", quiet)
    say(f"Wrote {output}.", quiet)
    if as_json:
        described = calibration.describe()
        kept = ("sensor_name", "image_shape", "mm_per_px", "color_model", "settings", "digest")
        print_json({"calibration": str(output), **{key: described[key] for key in kept}})
