"""gelform export: a calibration or a result as files of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gelform.cli.console import say
from gelform.cli.options import Overwrite, Quiet, one_of
from gelform.errors import DataError

RENDERERS = ("taxim", "isaaclab")  # as in exporters.taxim, which help does not import
FILES = ("ply", "stl", "tiff", "png", "x3p")


def export(
    source: Annotated[Path, typer.Argument(metavar="CAL.npz|RESULT.npz", help="A calibration or a result.")],
    to: Annotated[
        str,
        typer.Option("--to", help="taxim, isaaclab (a calibration); ply, stl, tiff, png, x3p (a result)."),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="DIR|FILE", help="A new folder (calibration); a file (result)."
        ),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Write a calibration or a result for another program.

    A calibration becomes the tables (polycalib.npz, bg.jpg, real_bg.npy) from which Taxim and TacEx (--to taxim) or
    Isaac Lab's GelSightRenderCfg (--to isaaclab) render this sensor. A result becomes a surface: ply (triangles in
    mm, camera's optical frame), stl (closed, to print), tiff (float depth, mm), png (16 bits, 0.1 um a step),
    x3p (ISO 25178-72).

    \b
    Examples:
      gelform export cal.npz --to taxim -o my-sensor
      gelform export cal.npz --to isaaclab -o assets/my-sensor
      gelform export out/coin.npz --to stl -o coin.stl
    """
    from gelform.calibration_file import KIND as CALIBRATION
    from gelform.npz_files import kind_of_npz
    from gelform.reconstruction import KIND as RESULT

    to = one_of(to, RENDERERS + FILES, "--to")
    kind, wanted = kind_of_npz(source) or "", CALIBRATION if to in RENDERERS else RESULT
    if kind != wanted:
        what = {CALIBRATION: "a calibration", RESULT: "a result"}
        raise DataError(
            f"Expected {what[wanted]} to write for {to}, got {what.get(kind, 'neither a calibration nor a result')} "
            f"in {source}. A calibration is written for {', '.join(RENDERERS)}; a result for {', '.join(FILES)}."
        )
    if to in RENDERERS:
        from gelform.exporters.taxim import save_taxim

        written = save_taxim(source, output or source.with_suffix(f".{to}"), renderer=to)
    else:
        from gelform.exporters.surface import save_surface
        from gelform.reconstruction import load_result

        target = output or source.with_suffix(f".{to}")
        if target.suffix.lower().lstrip(".") not in (to, to[:3]):
            raise typer.BadParameter(
                f"expected a name that ends in .{to}, got {target}.", param_hint="--output"
            )
        written = save_surface(load_result(source), target, overwrite=overwrite)
    say(f"Wrote {written}.", quiet)
