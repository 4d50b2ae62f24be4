"""gelform compare: what two calibrations say of the same images."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gelform.cli.console import figure, print_json, progress_shown, say, show_table
from gelform.cli.options import Background, Images, Json, Overwrite, PictureFolder, Quiet
from gelform.cli.result_names import make_folder, picture_paths
from gelform.cli.sensor_images import background_in, image_in, reconstruction_of

if TYPE_CHECKING:
    from gelform.reconstruct import Reconstructor

KEYS = ("peak_a", "peak_b", "difference_rms", "angle_deg", "curl_rms_a", "curl_rms_b")


def compare(
    images: Images,
    calibrations: Annotated[
        list[Path], typer.Option("--calibration", "-c", metavar="CAL.npz", help="Give it twice: A and B.")
    ],
    output: PictureFolder = None,
    background: Background = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Compare two calibrations on the same images: depth, normals and curl, with a picture of both.

    Depths are compared in mm, or in pixels where one calibration has no scale. The angle is the mean between
    the normals where either sees contact. With -o, DIR/<image>.png shows both depths on one scale, their
    difference, and the profile through the deepest point.

    \b
    Examples:
      gelform compare frame.png -c mine.npz -c imported.npz -o side-by-side
      gelform compare session/*.png -c before.npz -c after.npz --json
    """
    if len(calibrations) != 2:
        raise typer.BadParameter(f"expected two, got {len(calibrations)}.", param_hint="--calibration")
    protected = [*calibrations, *([background] if background else [])]
    pictures = picture_paths(images, output, overwrite=overwrite, protected=protected)
    with progress_shown(quiet) as progress:
        progress(0, len(images), "starting")
        pair = _pair(calibrations, background)
        names = (calibrations[0].stem, calibrations[1].stem)
        rows = []
        for done, (image, picture) in enumerate(zip(images, pictures)):
            rows.append(_compare_one(pair, image, picture, names, overwrite))
            progress(done + 1, len(images), "comparing")
    _report(rows, output, quiet or as_json)
    if as_json:
        print_json({"a": str(calibrations[0]), "b": str(calibrations[1]), "images": rows})


def _pair(calibrations: list[Path], background: Path | None) -> tuple[Reconstructor, Reconstructor]:
    from gelform.calibration_file import load_calibration
    from gelform.reconstruct import Reconstructor

    loaded = [load_calibration(path) for path in calibrations]
    a, b = (Reconstructor(one, background=background_in(background, one)) for one in loaded)
    return a, b


def _compare_one(
    pair: tuple[Reconstructor, Reconstructor],
    path: Path,
    picture: Path | None,
    names: tuple[str, str],
    overwrite: bool,
) -> dict[str, Any]:
    from gelform.plots.comparison import compare_results, comparison_picture

    images = [image_in(path, run.calibration) for run in pair]
    a, b = (reconstruction_of(run, image, path) for run, image in zip(pair, images))
    compared = compare_results(a, b)
    if picture is not None:
        from gelform.plots.canvas import save_picture

        make_folder(picture.parent)
        save_picture(picture, comparison_picture(a, b, images[0], names=names), overwrite=overwrite)
    return {"image": str(path), "picture": picture and str(picture), **compared.figures()}


def _report(rows: list[dict[str, Any]], output: Path | None, quiet: bool) -> None:
    unit = rows[0]["unit"]
    table = [(row["image"], *(figure(row[key]) for key in KEYS)) for row in rows]
    columns = (
        f"peak A ({unit})",
        f"peak B ({unit})",
        f"B - A rms ({unit})",
        "angle (deg)",
        "curl A",
        "curl B",
    )
    show_table("Comparison", ("image", *columns), table, quiet=quiet)
    if output is not None:
        say(f"Wrote {len(rows)} {'picture' if len(rows) == 1 else 'pictures'} to {output}.", quiet)
