"""gelform reconstruct: images to depth in mm."""

from __future__ import annotations

import webbrowser
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, BadParameter, Option

import gelform
from gelform.cli import options
from gelform.cli.commands.batch import Frames, batch
from gelform.cli.console import ShownOption, check_pictures, figure, say
from gelform.cli.files import Inputs, check_results, make_folder, named, result_paths, save_by_name
from gelform.cli.process import MISTAKE, one_line, status_of
from gelform.errors import GelformError, reason
from gelform.foundations.findings import FrameTally

if TYPE_CHECKING:
    from gelform.arrays import Image

FORMATS = ("npz", "png", "ply", "stl", "tiff", "x3p")  # png is a picture; as a surface it would be depth
SHEET, TILES = "sheet.png", 24  # the contact sheet of --view, and its frames at most


def reconstruct(
    *,
    inputs: Annotated[
        list[Path],
        Argument(
            metavar="INPUT...", help="Images, folders, patterns in quotes; or one video, stack or recording."
        ),
    ],
    given: Inputs,
    output: options.ResultFolder,
    solver: options.Solver = "auto",
    formats: Annotated[
        str, Option("--format", help="npz, png (a picture), ply, stl, tiff, x3p; several: npz,png.")
    ] = "npz",
    dataset: options.Dataset = "",
    skip_existing: Annotated[
        bool, Option("--skip-existing", help="Skip images that have results, to continue a run.")
    ] = False,
    view: Annotated[
        bool, Option("--view", help="Open a picture of the result, or a contact sheet of several.")
    ] = False,
    strict: Annotated[bool, Option("--strict", help="Exit with status 1 if a result has a warning.")] = False,
    accept_doubtful: options.AcceptDoubtful = False,
    overwrite: options.Overwrite = False,
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
    wanted = list(dict.fromkeys(one.strip() for one in formats.split(",") if one.strip()))
    if not wanted or not {*wanted} <= {*FORMATS}:
        expected = f"expected formats among {', '.join(FORMATS)}, got {formats!r}."
        raise BadParameter(expected, param_hint="--format")
    images, film = given.images_or_film(inputs, dataset)
    if film is not None:
        if wanted != ["npz"] or strict or skip_existing:
            only = "of a video or a recording, results are npz, and a run continues by itself."
            raise BadParameter(only, param_hint="--format, --strict, --skip-existing")
        try:
            batch(
                source=str(inputs[0]),
                given=Frames(**vars(given), dataset=dataset),
                output=output,
                keep="all",
                solver=solver,
                shard=(1, 1),
                overwrite=overwrite,
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
    new = [path for _, results in todo for path in results.values()]
    sheet = [output / SHEET] if view and len(images) > 1 else []
    overwrite = overwrite or skip_existing
    check_results([*new, *sheet], overwrite=overwrite, protected=protected)
    if "png" in wanted:
        check_pictures()
    from gelform.depth.solvers import SOLVERS

    options.one_of(solver, ("auto", *SOLVERS), "--solver")
    used = given.calibration_of(images, shown.quiet)
    with shown.progress() as progress:
        run, pitch = given.reconstructor(used, solver=solver), used.mm_per_px
        unit = "px" if pitch is None else "mm"
        rows, failed, tiles, tally = [], [], [], FrameTally()
        for done, (path, results) in enumerate(todo):
            try:
                image = given.image(path, run.calibration)
                with named(path):
                    result = run.from_image(image)
            except (GelformError, MemoryError) as problem:
                failed.append({"image": str(path), "error": one_line(reason(problem))})
            else:
                _write(result, image, results, overwrite)
                rows.append(_row(result, path, results))
                tally.add((one.name for one in result.health), known=bool(result.known.any()))
                if sheet and (len(rows) - 1) % -(-len(todo) // TILES) == 0:
                    peak = figure(rows[-1][f"peak_{unit}"])
                    note = f"{peak} {unit} {' '.join(one.name for one in result.health)}"
                    tiles.append((result.depth, f"{path.parent.name}/{path.stem}", note))
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

        with written_file(sheet[0], overwrite=overwrite) as file:
            file.write(contact_sheet(tiles, pitch, unit))
    if view and rows:
        _open(sheet[0] if sheet else paths[0]["png"], shown)
    shown.json({"results": rows, "failed": failed})
    if failed or (strict and any(row["findings"] for row in rows)):
        raise typer.Exit(MISTAKE)
    raise typer.Exit(status_of(tally, accept_doubtful=accept_doubtful, quiet=True))


def _open(picture: Path, shown: ShownOption) -> None:
    shown.say(f"Look at {picture}.")
    webbrowser.open(picture.resolve().as_uri())


def _write(result: gelform.Reconstruction, image: Image, results: dict[str, Path], overwrite: bool) -> None:
    from gelform.exchange.plots import save_picture

    for form, path in results.items():
        make_folder(path.parent)
        if form == "png":
            save_picture(path, gelform.picture(result, image), overwrite=overwrite)
        else:
            save_by_name(result, path, overwrite=overwrite)


def _row(result: gelform.Reconstruction, path: Path, results: dict[str, Path]) -> dict[str, Any]:
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
    found = [finding for row in rows for finding in row["findings"]]
    first = {finding["name"]: finding["message"] for finding in reversed(found)}
    for name, count in Counter(finding["name"] for finding in found).items():
        say(f"warning ({count} of {len(rows)} images): {first[name]}")
    scaled = all("peak_mm" in row for row in rows)
    lengths = {"peak_mm": "peak (mm)", "contact_mm2": "contact (mm²)"}
    columns = lengths if scaled else {"peak_px": "peak (px)", "contact_px": "contact (px)"}
    table = [{"file": row["outputs"][0], **row} for row in rows]
    shown.table("Results", {"file": "file", **columns, "curl_rms": "curl (1/px)"}, table)
    if not scaled:
        say("The scale of this calibration is unknown, so results hold depth_px, not depth_mm.", shown.silent)
