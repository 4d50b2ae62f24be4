"""gelform import and gelform export: exchange of calibrations and results with other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import BadParameter, Option

import gelform
from gelform import DataError, result
from gelform.cli import options
from gelform.cli.console import ShownOption, mistakes_in, say
from gelform.cli.files import check_output
from gelform.cli.options import argument, listed, one_of, option
from gelform.sensors.profiles import check_gel_width

RENDERERS = ("taxim", "isaaclab")  # as in exporters.surface, which the help does not import
FILES = ("ply", "stl", "tiff", "png", "x3p")


def import_(
    *,
    file: Annotated[Path, argument("FILE", "The package's calibration file.")],
    package: Annotated[
        str, Option("--from", metavar="PACKAGE", help=f"The package: {listed(options.PACKAGES)}.")
    ],
    output: options.NewCalibration,
    background: options.Background = None,
    mm_per_px: options.MmPerPx = None,
    position: Annotated[
        str | None,
        option("zeros|true", "For gsrobotics: zeros, as in its own program, or the true positions."),
    ] = None,
    flip_depth: Annotated[
        bool, Option("--flip-depth", help="For lut: reverse depth that falls where pressed.")
    ] = False,
    range_: Annotated[
        tuple[float, float] | None,
        Option("--range", metavar="LOW HIGH", help="For lut: differences that the table spans, gray levels."),
    ] = None,
    name: Annotated[str | None, option("NAME", "Name of the sensor.")] = None,
    overwrite: options.Overwrite = False,
    shown: ShownOption,
) -> None:
    """Import a calibration that another package made.

    Networks of gs_sdk (nnmodel.pth), gsrobotics (nnmini.pt) and its browser port, and look-up tables (table_smooth.npy,
    MATLAB's LookupTable in a .mat). Nothing in FILE is executed. The background is an image of the gel at rest, cropped and
    sized as that package's images are. Without --mm-per-px, results are gradients and depth in pixels.

    \b
    Examples:
      gelform import nnmodel.pth --from gs_sdk --background rest.png --mm-per-px 0.0634 -o cal.npz
      gelform import nnmini.pt --from gsrobotics --position zeros --background rest.png -o cal.npz
      gelform import table_smooth.npy --from lut --flip-depth --range -256 256 --background rest.png -o cal.npz
      gelform import table.mat --from lut --background rest.png -o cal.npz
    """
    one_of(package, options.PACKAGES, "--from")
    if background is None:
        raise BadParameter(
            "needed: an image of the gel at rest; these files hold none.", param_hint="--background"
        )
    from gelform.exchange.importers import RANGE_LEVELS, is_matlab

    check_output(output, overwrite=overwrite)
    with mistakes_in(file):
        calibration = gelform.import_calibration(
            file,
            package,
            background=gelform.read_image(background),
            mm_per_px=mm_per_px,
            position=position,
            flip_depth=flip_depth,
            range_levels=range_,
            sensor_name=name,
        )
    calibration.save(output, overwrite=overwrite)
    if package == "lut" and range_ is None and not is_matlab(file):
        low, high = RANGE_LEVELS
        shown.say(
            f"note: {file} does not state its range, so {low:g} to {high:g} gray levels are assumed. With another "
            "one, every depth is wrong. Look into the program that wrote it (zeropoint, lookscale); give --range LOW HIGH."
        )
    if steepest := calibration.settings.others.get("steepest_slope"):
        shown.say(f"The table's steepest slope is {steepest:.3g}.")
    for finding in calibration.findings:
        say(f"warning: {finding.message}")
    if mm_per_px is None and calibration.mm_per_px is not None:
        shown.say(f"{file} states {calibration.mm_per_px:g} mm per pixel.")
    if calibration.mm_per_px is None:
        shown.say("note: without --mm-per-px the scale is unknown, so results are in pixels, not mm.")
    elif doubt := check_gel_width(calibration.image_shape, calibration.known_mm_per_px):
        shown.say(f"note: {doubt}")
    if not calibration.view.is_identity:
        height, width = calibration.view.frame_shape or (0, 0)
        shown.say(
            f"Frames of {height}x{width} px are cropped and resized as {package} does, images are taken as they are."
        )
    shown.say(f"Wrote {output}.")
    described = calibration.describe()
    kept = ("sensor_name", "image_shape", "mm_per_px", "color_model", "settings", "digest")
    shown.json({"calibration": str(output), **{key: described[key] for key in kept}})


def export(
    *,
    source: Annotated[Path, argument("CAL.npz|RESULT.npz", "A calibration or a result.")],
    to: Annotated[
        str, Option("--to", help="taxim, isaaclab (a calibration); ply, stl, tiff, png, x3p (a result).")
    ],
    output: Annotated[
        Path | None, options.output("DIR|FILE", "A new folder (calibration); a file (result).")
    ] = None,
    overwrite: options.Overwrite = False,
    quiet: options.Quiet = False,
) -> None:
    """Write a calibration or a result for another program.

    A calibration becomes the tables (polycalib.npz, bg.jpg, real_bg.npy) from which Taxim and TacEx (--to taxim) or
    Isaac Lab's GelSightRenderCfg (--to isaaclab) render this sensor. A result becomes a surface: ply (triangles in mm, in
    the camera's optical frame), stl (closed, to print), tiff (float depth, mm), png (16 bits, 0.1 um per step),
    x3p (ISO 25178-72).

    \b
    Examples:
      gelform export cal.npz --to taxim -o my-sensor
      gelform export cal.npz --to isaaclab -o assets/my-sensor
      gelform export out/coin.npz --to stl -o coin.stl
    """
    from gelform.calibration_file import KIND as CALIBRATION
    from gelform.exchange.exporters.surface import save_surface, save_taxim
    from gelform.foundations.files import kind_of_npz

    one_of(to, RENDERERS + FILES, "--to")
    kind, wanted = kind_of_npz(source) or "", CALIBRATION if to in RENDERERS else result.KIND
    if kind != wanted:
        what = {CALIBRATION: "a calibration", result.KIND: "a result"}
        raise DataError(
            f"Expected {what[wanted]} to write for {to}, got {what.get(kind, 'neither a calibration nor a result')} "
            f"in {source}. A calibration is written for {', '.join(RENDERERS)}; a result for {', '.join(FILES)}."
        )
    target = output or source.with_suffix(f".{to}")
    if to in RENDERERS:
        written = save_taxim(source, target, renderer=to)
    else:
        if target.suffix.lower().lstrip(".") not in (to, to[:3]):
            raise BadParameter(f"expected a name that ends in .{to}, got {target}.", param_hint="--output")
        written = save_surface(gelform.load_result(source), target, overwrite=overwrite)
    say(f"Wrote {written}.", quiet)
