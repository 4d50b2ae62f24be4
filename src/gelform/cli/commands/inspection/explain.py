"""gelform explain: why each pixel of an image was trusted or not."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from gelform.cli.console import figure, print_json, say, show_table
from gelform.cli.options import Background, CalibrationFile, Images, Json, Overwrite, PictureFolder, Quiet
from gelform.cli.result_names import make_folder, picture_paths
from gelform.cli.sensor_images import background_in, image_in
from gelform.errors import CalibrationError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from gelform.confidence import Explanation
    from gelform.reconstruct import Reconstructor


def explain(
    images: Images,
    calibration: CalibrationFile,
    output: PictureFolder = None,
    background: Background = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Explain why each pixel of an image was trusted or not.

    Lists how much of the slopes' variance is due to the law of slope and place, and to each named cause: saturated,
    dark, shadow, specular, wall, off_gamut, inconsistent, marker, outside, compression. With -o, DIR/<image>.png draws
    the confidence, and what each cause adds, pixel by pixel.

    \b
    Examples:
      gelform explain frame.png -c cal.npz -o why
      gelform explain session/*.png -c cal.npz --json
      gelform explain frame.png -c cal.npz --background today_rest.png -o why --overwrite
    """
    protected = [calibration, *([background] if background else [])]
    pictures = picture_paths(images, output, overwrite=overwrite, protected=protected)
    run = _prepared(calibration, background)
    rows = [_explain_one(run, path, picture, overwrite) for path, picture in zip(images, pictures)]
    _report(rows, output, quiet or as_json)
    if as_json:
        print_json({"calibration": str(calibration), "images": rows})


def _prepared(calibration: Path, background: Path | None) -> Reconstructor:
    from gelform.calibration_file import load_calibration
    from gelform.reconstruct import Reconstructor

    loaded = load_calibration(calibration)
    return Reconstructor(loaded, background=background_in(background, loaded), depth_sigma=False)


def _explain_one(run: Reconstructor, path: Path, picture: Path | None, overwrite: bool) -> dict[str, Any]:
    image = image_in(path, run.calibration)
    try:
        found = run.explain(image)
    except CalibrationError as problem:
        raise CalibrationError(f"{path}: {problem}") from problem
    if picture is not None:
        _draw(found, image, picture, overwrite)
    return {"image": str(path), "picture": picture and str(picture), **found.to_dict()}


def _draw(found: Explanation, image: NDArray[np.uint8], picture: Path, overwrite: bool) -> None:
    from gelform.plots.canvas import save_picture
    from gelform.plots.explanation import explanation_picture

    make_folder(picture.parent)
    save_picture(picture, explanation_picture(found, image), overwrite=overwrite)


def _report(rows: list[dict[str, Any]], output: Path | None, quiet: bool) -> None:
    for row in rows:
        for finding in row["findings"]:
            say(f"{row['image']}: {finding['message']}", quiet)
    names = [name for name in rows[0]["variance_shares"] if any(row["variance_shares"][name] for row in rows)]
    table = [
        (
            row["image"],
            figure(100 * row["trusted_share"]),
            figure(row["median_sigma"]),
            *(figure(100 * row["variance_shares"][name]) for name in names),
        )
        for row in rows
    ]
    columns = ("trusted (% of px)", "sigma (median)", *(f"{name} (%)" for name in names))
    show_table("Share of the slopes' variance", ("image", *columns), table, quiet=quiet)
    if output is not None:
        say(f"Wrote {len(rows)} {'picture' if len(rows) == 1 else 'pictures'} to {output}.", quiet)
