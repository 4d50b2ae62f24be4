"""gelform reconstruct: images to depth in mm."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, BadParameter, Option

from gelform.cli.console import check_pictures, figure, say
from gelform.cli.files import Inputs, check_results, make_folder, named, result_paths
from gelform.cli.options import AcceptDoubtful, Dataset, Overwrite, ShownOption, one_of
from gelform.cli.process import MISTAKE, one_line
from gelform.errors import GelformError, reason
from gelform.foundations.findings import FrameTally

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from gelform.result import Reconstruction

SURFACES = ("ply", "stl", "tiff", "x3p")  # of exporters.surface; png is a picture here, not depth
FORMATS = ("npz", "png", *SURFACES)
SHEET, TILES = "sheet.png", 24  # the contact sheet of --view, and its frames at most


def _formats(text: str) -> list[str]:
    formats = [one.strip() for one in text.split(",") if one.strip()]
    unknown = [one for one in formats if one not in FORMATS]
    if unknown or not formats:
        raise BadParameter(
            f"expected formats among {', '.join(FORMATS)}, got {text!r}.", param_hint="--format"
        )
    return list(dict.fromkeys(formats))


def reconstruct(
    *,
    inputs: Annotated[
        list[Path],
        Argument(
            metavar="INPUT...", help="Images, folders, patterns in quotes; or one video, stack or recording."
        ),
    ],
    given: Inputs,
    output: Annotated[Path, Option("--output", "-o", metavar="DIR", help="Folder for the results.")],
    solver: Annotated[str, Option(help="Solver from slopes to depth; auto chooses.")] = "auto",
    formats: Annotated[
        str,
        Option(
            "--format", help="What to write: npz, png (a picture), ply, stl, tiff, x3p; several: npz,png."
        ),
    ] = "npz",
    dataset: Dataset = "",
    skip_existing: Annotated[
        bool, Option("--skip-existing", help="Skip images that have results, to continue a run.")
    ] = False,
    view: Annotated[
        bool, Option("--view", help="Open a picture of the result, or a contact sheet of several.")
    ] = False,
    strict: Annotated[bool, Option("--strict", help="Exit with status 1 if a result has a warning.")] = False,
    accept_doubtful: AcceptDoubtful = False,
    overwrite: Overwrite = False,
    shown: ShownOption,
) -> None:
    """Reconstruct depth in mm from images.

    An image a/b/c.png becomes DIR/<path below the images' common folder>.npz with depth_mm, gradients,
    confidence, contact, known and mm_per_px. With --format npz,png a picture is added. An image that cannot be read or
    belongs to another sensor is reported. The other images are still done, and the exit status is 1. Of a folder, every
    image in it and below it is done. A video, a recording, a TIFF of several pages or an array of frames (.npy, RGB) is done
    as by gelform batch --keep all. If the depth of most
    images is doubtful, the exit status is 3.

    Without -c, the serial number in the images' sensor.toml or recording selects the newest calibration of that
    sensor. For a sensor without a calibration, give --sensor and an image of its gel at rest. The starter of its make
    then reads the images.

    \b
    Examples:
      gelform reconstruct frame.png -c cal.npz -o out
      gelform reconstruct session/ -c cal.npz -o out --view
      gelform reconstruct press.mp4 -c cal.npz -o out --view
      gelform reconstruct session/*/gelsight.png -c cal.npz -o out --format npz,png
      gelform reconstruct frame.png --sensor gelsight-mini --background rest.png -o out
      gelform reconstruct today/*.png -c cal.npz --background today_rest.png -o out --json
    """
    wanted = _formats(formats)
    images, film = given.images_or_film(inputs, dataset)
    if film is not None:
        if wanted != ["npz"] or strict or skip_existing:
            only = "of a video or a recording, results are npz, and a run continues by itself."
            raise BadParameter(only, param_hint="--format, --strict, --skip-existing")
        from gelform.cli.commands.batch import Frames, Machines, Results, Run, batch

        try:
            batch(
                source=str(inputs[0]),
                given=Frames(**vars(given), dataset=dataset),
                output=output,
                results=Results(keep="all", solver=solver),
                machines=Machines(shard=(1, 1)),
                run=Run(overwrite=overwrite),
                accept_doubtful=accept_doubtful,
                shown=shown,
            )
        finally:
            if view and (output / SHEET).exists():
                _open(output / SHEET, shown)
        return
    if dataset:
        raise BadParameter("is for an HDF5 file, a Zarr store or a LeRobot data set.", param_hint="--dataset")
    if view and len(images) == 1 and "png" not in wanted:
        wanted.append("png")
    paths = result_paths(images, output, wanted)
    protected = [*images, *filter(None, (given.calibration, given.background))]
    todo = list(zip(images, paths))
    if skip_existing:
        todo = [pair for pair in todo if not all(path.exists() for path in pair[1].values())]
    checked = [results for _, results in todo]
    sheet = {"png": output / SHEET} if view and len(images) > 1 else {}
    check_results([*checked, sheet], overwrite=overwrite or skip_existing, protected=protected)
    if "png" in wanted:
        check_pictures()
    from gelform.depth.solvers import SOLVERS

    one_of(solver, ("auto", *SOLVERS), "--solver")
    used = given.calibration_of(images, shown.quiet)
    with shown.progress() as progress:
        run = given.reconstructor(used, solver=solver)
        rows, failed, tiles, tally = [], [], [], FrameTally()
        for done, (path, results) in enumerate(todo):
            try:
                image = given.image(path, run.calibration)
                with named(path):
                    result = run.from_image(image)
            except (GelformError, MemoryError) as problem:
                failed.append({"image": str(path), "error": one_line(reason(problem))})
            else:
                _write(result, image, results, overwrite or skip_existing)
                rows.append(_row(result, path, results))
                tally.add((one.name for one in result.health), known=bool(result.known.any()))
                if sheet and (len(rows) - 1) % -(-len(todo) // TILES) == 0:
                    tiles.append((result.depth, f"{path.parent.name}/{path.stem}", _note(rows[-1])))
            progress(done + 1, len(todo), "reconstructing")
    for one in failed:
        say(f"gelform: error: {one['error']}")
    _report(rows, shown)
    if len(images) > len(rows) and len(images) > 1:
        skipped = len(images) - len(todo)
        shown.say(f"{len(rows)} of {len(images)} images done, {skipped} skipped, {len(failed)} failed.")
    if tiles:
        from gelform.batch.run import contact_sheet
        from gelform.foundations.files import written_file

        with written_file(sheet["png"], overwrite=overwrite or skip_existing) as file:
            pitch = run.calibration.mm_per_px
            file.write(contact_sheet(tiles, pitch, "px" if pitch is None else "mm"))
    if view and rows:
        _open(sheet["png"] if sheet else paths[0]["png"], shown)
    shown.json({"results": rows, "failed": failed})
    if failed or (strict and any(row["findings"] for row in rows)):
        raise typer.Exit(MISTAKE)
    from gelform.cli.process import status_of

    raise typer.Exit(status_of(tally, accept_doubtful=accept_doubtful, quiet=True))


def _open(picture: Path, shown: ShownOption) -> None:
    import webbrowser

    shown.say(f"Look at {picture}.")
    webbrowser.open(picture.resolve().as_uri())


def _note(row: dict[str, Any]) -> str:
    peak = f"{figure(row['peak_mm'])} mm" if "peak_mm" in row else f"{figure(row['peak_px'])} px"
    return f"{peak} {' '.join(finding['name'] for finding in row['findings'])}"


def _write(
    result: Reconstruction, image: NDArray[np.uint8], results: dict[str, Path], overwrite: bool
) -> None:
    from gelform.result import save_result

    make_folder(next(iter(results.values())).parent)
    if "npz" in results:
        save_result(result, results["npz"], overwrite=overwrite)
    for name in SURFACES:
        if name in results:
            from gelform.exchange.exporters.surface import save_surface

            save_surface(result, results[name], overwrite=overwrite)
    if "png" in results:
        from gelform.exchange.plots import picture, save_picture

        save_picture(results["png"], picture(result, image), overwrite=overwrite)


def _row(result: Reconstruction, path: Path, results: dict[str, Path]) -> dict[str, Any]:
    """The figures of one result, for JSON and for the table: in pixels if the scale is unknown, None if depth is."""
    peak, area, pixels = ((n := result.numbers) and (n.peak, n.area, n.contact_px)) or (None, None, None)
    lengths = {"peak_px": peak} if result.mm_per_px is None else {"peak_mm": peak, "contact_mm2": area}
    return {
        "image": str(path),
        "outputs": [str(one) for one in results.values()],
        **lengths,
        "contact_px": pixels,
        "contacts": [asdict(contact) for contact in result.contacts],
        "markers": None if result.markers is None else result.markers.facts(),
        "curl_rms": result.curl_rms,
        "findings": [asdict(finding) for finding in result.health],
    }


def _report(rows: Sequence[dict[str, Any]], shown: ShownOption) -> None:
    if not rows:
        return
    found = [(finding["name"], finding["message"]) for row in rows for finding in row["findings"]]
    for name, count in Counter(name for name, _ in found).items():
        message = next(text for other, text in found if other == name)
        say(f"warning ({count} of {len(rows)} images): {message}")
    scaled = "peak_mm" in rows[0]
    keys = ("peak_mm", "contact_mm2") if scaled else ("peak_px", "contact_px")
    table = [(row["outputs"][0], *(row[key] for key in (*keys, "curl_rms"))) for row in rows]
    columns = ("peak (mm)", "contact (mm²)") if scaled else ("peak (px)", "contact (px)")
    shown.table("Results", ("file", *columns, "curl (1/px)"), table)
    if not (scaled or shown.silent):
        say("The scale of this calibration is unknown, so results hold depth_px, not depth_mm.")
