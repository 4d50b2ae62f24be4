"""gelform reconstruct: images to depth in mm; gelform batch: a data set, resumable; gelform verify: check of its output."""

from __future__ import annotations

import sys
import time
import webbrowser
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import BadParameter, Option

import gelform
from gelform.cli import options
from gelform.cli.console import (
    LINE_EVERY_S,
    MISTAKE,
    ShownOption,
    check_pictures,
    figure,
    one_line,
    say,
    status_of,
)
from gelform.cli.files import FilmInputs, check_results, make_folder, named, result_paths, save_by_name
from gelform.cli.options import argument, one_of, option, usage_errors
from gelform.errors import FrameTally, GelformError, counted, reason
from gelform.result.maps import KEPT_MAPS

if TYPE_CHECKING:
    from gelform.arrays import Image
    from gelform.batch import BatchSummary

FORMATS = ("npz", "png", "ply", "stl", "tiff", "x3p")  # png is a picture; as a surface it would be depth
SHEET, TILES = "sheet.png", 24  # the contact sheet of --view, and its frames at most


def reconstruct(
    *,
    inputs: Annotated[
        list[Path],
        argument("INPUT...", "Images, folders, patterns in quotes; or one video, stack or recording."),
    ],
    given: FilmInputs,
    output: options.ResultFolder,
    formats: Annotated[
        str, Option("--format", help="npz, png (a picture), ply, stl, tiff, x3p; several: npz,png.")
    ] = "npz",
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
    as by gelform batch --keep all; what --format names besides npz is in DIR/png/ ... If the depth of most
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
    wanted = [*options.names_from(formats)]
    if not wanted or not {*wanted} <= {*FORMATS}:
        expected = f"expected formats among {', '.join(FORMATS)}, got {formats!r}."
        raise BadParameter(expected, param_hint="--format")
    images, film = given.images_or_film(inputs, given.dataset)
    if film is not None:
        if strict or skip_existing:
            option, instead = (
                ("--strict", "exit status 3 tells of doubt")
                if strict
                else ("--skip-existing", "it continues")
            )
            raise BadParameter(f"is for images. Leave it out for {film}: {instead}.", param_hint=option)
        if "png" in wanted:
            check_pictures()
        try:
            batch(
                source=str(inputs[0]),
                given=Frames(**vars(given)),
                output=output,
                keep="all",
                shard=(1, 1),
                overwrite=overwrite,
                accept_doubtful=accept_doubtful,
                shown=shown,
            )
        except typer.Exit:
            _export_frames(output, [form for form in wanted if form != "npz"], shown)
            raise
        finally:
            if view and (output / SHEET).exists():
                _open(output / SHEET, shown)
        return
    if given.dataset:
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
    used = given.calibration_of(images, shown.quiet)
    with shown.progress() as progress:
        run, pitch = given.reconstructor(used), used.mm_per_px
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
    alike: dict[str, list[str]] = {}
    for one in failed:
        alike.setdefault(one["error"].replace(one["image"], ""), []).append(one["error"])
    for errors in alike.values():
        more = (
            f" {counted(len(errors) - 1, 'more image')} with this error: --json names them."
            if errors[1:]
            else ""
        )
        say(f"gelform: error: {errors[0]}{more}")
    _report(rows, shown)
    if len(images) > len(rows) and len(images) > 1:
        skipped = len(images) - len(todo)
        shown.say(
            f"{len(rows)} of {counted(len(images), 'image')} done, {skipped} skipped, {len(failed)} failed."
        )
    if tiles:
        from gelform.batch.run import contact_sheet
        from gelform.foundations.files import written_file

        with written_file(sheet[0], overwrite=overwrite) as file:
            file.write(contact_sheet(tiles, pitch, unit))
    if view and rows:
        shows = (
            f", which shows {len(tiles)} of {len(rows)} images" if len(tiles) < len(rows) and sheet else ""
        )
        _open(sheet[0] if sheet else paths[0]["png"], shown, shows)
    shown.json({"results": rows, "failed": failed})
    if failed or (strict and any(row["findings"] for row in rows)):
        raise typer.Exit(MISTAKE)
    raise typer.Exit(status_of(tally, accept_doubtful=accept_doubtful, quiet=True))


def _open(picture: Path, shown: ShownOption, shows: str = "") -> None:
    shown.say(f"Look at {picture}{shows}.")
    webbrowser.open(picture.resolve().as_uri())


def _export_frames(output: Path, forms: Sequence[str], shown: ShownOption) -> None:
    """Write the results of a batch in other forms, below a folder of each form's name."""
    frames = output / "frames"
    files = sorted(path for path in frames.rglob("*.npz") if not path.name.startswith(".")) if forms else []
    with shown.progress() as progress:
        for done, path in enumerate(files):
            progress(done, len(files), f"writing {', '.join(forms)}")
            below = path.relative_to(frames)
            results = {form: output / form / below.with_suffix(f".{form}") for form in forms}
            _write(gelform.load_result(path), None, results, overwrite=True)


def _write(
    result: gelform.Reconstruction, image: Image | None, results: dict[str, Path], overwrite: bool
) -> None:
    from gelform.exchange.plots import save_picture

    for form, path in results.items():
        make_folder(path.parent)
        if form == "png":
            save_picture(path, gelform.picture(result, image), overwrite=overwrite)
        else:
            save_by_name(result, path, overwrite=overwrite)


def _row(result: gelform.Reconstruction, path: Path, results: dict[str, Path]) -> dict[str, Any]:
    """The figures of one result, for JSON and for the table: in pixels if the scale is unknown, None if depth is."""
    numbers = result.numbers
    peak, area, pixels = (
        (None, None, None) if numbers is None else (numbers.peak, numbers.area, numbers.contact_px)
    )
    lengths = {"peak_px": peak} if result.mm_per_px is None else {"peak_mm": peak, "contact_mm2": area}
    return {
        "image": str(path),
        "outputs": [str(one) for one in results.values()],
        **lengths,
        "at_least": numbers is not None and numbers.at_least,
        "contact_px": pixels,
        "contacts": [asdict(contact) for contact in result.contacts],
        "markers": None if result.markers is None else result.markers.facts(),
        "curl_rms": result.curl_rms,
        "findings": [asdict(finding) for finding in result.health],
    }


def _report(rows: Sequence[dict[str, Any]], shown: ShownOption) -> None:
    findings = [finding for row in rows for finding in row["findings"]]
    first = {finding["name"]: finding["message"] for finding in reversed(findings)}
    for name, count in Counter(finding["name"] for finding in findings).items():
        say(f"warning ({count} of {counted(len(rows), 'image')}): {first[name]}")
    scaled = all("peak_mm" in row for row in rows)
    lengths = {"peak_mm": "peak (mm)", "contact_mm2": "contact (mm²)"}
    columns = lengths if scaled else {"peak_px": "peak (px)", "contact_px": "contact (px)"}
    peak = next(iter(columns))
    table = [{"file": row["outputs"][0], **row} for row in rows]
    for row in table:
        row[peak] = f"at least {figure(row[peak])}" if row["at_least"] else row[peak]
    shown.table("Results", {"file": "file", **columns, "curl_rms": "curl (1/px)"}, table)
    if not scaled:
        say("The scale of this calibration is unknown, so results hold depth_px, not depth_mm.", shown.silent)


def _shard(text: str) -> tuple[int, int]:
    number, _, count = text.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise BadParameter(f"expected i/N with i from 1 to N, such as 3/16, got {text!r}.")
    return int(number), int(count)


@dataclass(frozen=True)
class Frames(FilmInputs):
    """Inputs of many sequences: also the places of frames and of background images."""

    background: Annotated[
        Path | None,
        option(
            "IMG|DIR|CSV", "Gel at rest: an image, a folder of several, or a table of sequence,background."
        ),
    ] = None
    background_frames: Annotated[
        int, Option(metavar="N", min=0, help="Average the first N frames of each sequence as its background.")
    ] = 0

    @property
    def from_film(self) -> bool:
        return self.background_frames > 0 and self.background is None


def batch(
    *,
    source: Annotated[
        str,
        argument("INPUT", "Folder, video, recording, HDF5, Zarr, LeRobot, or a pattern in quotes."),
    ],
    given: Frames,
    output: options.ResultFolder,
    form: Annotated[
        str, Option("--format", help="npz, png (16-bit depth), zarr, hdf5, lerobot (its input with depth).")
    ] = "npz",
    dtype: Annotated[
        str | None, Option(help="For zarr and hdf5: float32, or uint16 (depth only, 0.1 um per step).")
    ] = None,
    table: Annotated[str, Option(help="parquet or csv; auto: parquet if pyarrow is installed.")] = "auto",
    keep: Annotated[str, Option(help=f"Maps to save: {', '.join(KEPT_MAPS)}; all: whole results.")] = (
        "depth,known"
    ),
    workers: Annotated[int, Option(min=1, metavar="N", help="Number of processes; for Ray, of CPUs.")] = 1,
    engine: Annotated[str, Option(help="pool (processes on this machine) or ray.")] = "pool",
    address: Annotated[
        str | None, option("ADDRESS", "Address of a running Ray cluster, such as auto.")
    ] = None,
    shard: Annotated[
        Any, Option(metavar="I/N", parser=_shard, help="Do only the I-th of N shares, for a job array.")
    ] = "1/1",
    max_errors: Annotated[
        int, Option(min=0, metavar="N", help="End the run when more frames than this have errors.")
    ] = 1000,
    retry_errors: Annotated[
        bool, Option("--retry-errors", help="Process again the parts that had errors.")
    ] = False,
    overwrite: Annotated[
        bool, Option("--overwrite", help="Delete the earlier batch there, and start again.")
    ] = False,
    accept_doubtful: options.AcceptDoubtful = False,
    shown: ShownOption,
) -> None:
    """Reconstruct every frame of a data set.

    The same command continues an interrupted run. `gelform batch verify DIR` checks all output.

    INPUT is a folder (with all folders below it), a video, a recording (MCAP or a folder), an HDF5 file, a Zarr store, a
    LeRobot data set, or a pattern. DIR gets frames/<sequence>/<frame>.npz, a table with one row per frame, and
    manifest.json. A frame that cannot be read or has another size gets a row with its error; the other frames are still
    done, and the exit status is 1. The run ends with a summary of the frames' findings. If the depth of most frames is
    doubtful, the exit status is 3.

    Without -c, the serial number in a sensor.toml or in the recordings selects the newest calibration of that sensor; there
    must be only one serial. For a sensor without a calibration, give --sensor and an image of its gel at rest, or
    --background-frames where each sequence begins at rest. The starter of its make then reads the frames.

    \b
    Examples:
      gelform batch sessions/ -c cal.npz -o depth --workers 4
      gelform batch "day*/*.mp4" -c cal.npz -o depth --background-frames 10 --format png
      gelform batch demos.hdf5 --dataset "data/*/obs/gelsight" -c cal.npz -o depth --format zarr --dtype uint16
      gelform batch press_set --dataset observation.images.gel -c cal.npz -o with_depth --format lerobot
      gelform batch sessions/ --sensor gelsight-mini --background rest.png -o depth
      gelform batch "day*/*.mp4" --sensor gelsight-mini --background-frames 5 -o depth
      gelform batch sessions/ -c cal.npz -o depth --shard 3/16
    """
    from gelform.batch import BatchSettings, Engine, RunOptions, run_batch
    from gelform.calibration.library import NoCalibration

    one_of(table, ("auto", "parquet", "csv"), "--table")
    maps = options.names_from(keep)
    with usage_errors():
        settings = BatchSettings(form, maps, given.background_frames, dtype=dtype or "", bgr=given.bgr)
        machines = Engine(engine, workers, address)
    with _progress(shown.silent) as progress:
        work = partial(
            run_batch,
            source,
            output=output,
            settings=settings,
            background=given.background,
            dataset=given.dataset,
            table=table,
            engine=machines,
            options=RunOptions(max_errors, retry_errors, overwrite, shard),
            progress=progress,
            chosen=shown.say,
        )
        try:
            starter = None
            if given.sensor is not None and given.from_film:
                starter = partial(
                    gelform.calibration_from_background, sensor=given.sensor, mm_per_px=given.mm_per_px
                )
            summary = work(calibration=given.calibration, starter=starter)
        except NoCalibration as problem:
            summary = work(calibration=given.starter("", problem, shown.silent))
    shown.json({"output": output, **asdict(summary)})
    _report_batch(summary, output, max_errors, shown.silent)
    if table == "auto" and summary.complete and summary.table.endswith(".csv"):
        shown.say("The table is CSV, because pyarrow (the extra data) is not installed.")
    raise typer.Exit(status_of(summary.tally, accept_doubtful=accept_doubtful, quiet=shown.silent))


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[BatchSummary], None]]:
    """Show a line on standard error: updated on a terminal, a new one every half minute in a file."""
    on_screen = sys.stderr is not None and sys.stderr.isatty()
    begin, last, before = time.monotonic(), 0.0, -1

    def report(summary: BatchSummary) -> None:
        nonlocal last, before
        now = time.monotonic()
        before = summary.parts_done - 1 if before < 0 else before
        if quiet or now - last < (0.2 if on_screen else LINE_EVERY_S):  # s between lines, which a file keeps
            return
        last = now
        line = _line(summary, now - begin, summary.parts_done - before)
        typer.echo(f"\r{line}\x1b[K" if on_screen else line, err=True, nl=not on_screen)

    yield report
    if on_screen and last:
        typer.echo(err=True)


def _line(summary: BatchSummary, seconds: float, parts: int) -> str:
    """Parts, rate, time left, errors so far."""
    left = timedelta(seconds=round((summary.parts - summary.parts_done) * seconds / parts))
    rate_hz = summary.frames / max(seconds, 1e-9)
    done = f"{summary.parts_done} of {counted(summary.parts, 'part')}, {rate_hz:.1f} frames/s"
    return f"{done}, {left} left, {summary.errors} with errors"


def _report_batch(summary: BatchSummary, output: Path, max_errors: int, quiet: bool) -> None:
    for warning in summary.warnings:
        say(f"gelform: warning: {warning}")
    before = f", {summary.frames_before} from earlier runs" if summary.frames_before else ""
    say(f"{counted(summary.frames, 'frame')} done{before}; {summary.errors} with errors.", quiet)
    if summary.stopped:
        say(
            f"gelform: error: {counted(summary.errors, 'frame')} with errors, more than --max-errors {max_errors} "
            f"allows. The finished parts and the reasons are in {output / 'parts'}. Fix the files or allow more errors, and "
            "run again."
        )
    elif summary.complete:
        sheet = output / SHEET  # not written where no frame has depth
        frames = summary.frames + summary.frames_before - summary.errors
        some = f", which shows {TILES} of {frames}" if frames > TILES else ""
        look = f"; look at {sheet}{some}" if sheet.exists() else ""
        say(f"Complete: {output / summary.table} has a row for each frame{look}.", quiet)
        if summary.errors:
            say(
                "The column error gives the reasons. Fix the frames and run again with --retry-errors.", quiet
            )
    else:
        say("This shard is done. The last shard writes the table.", quiet)


def verify(
    *,
    output: Annotated[Path, argument("OUTPUT", "Folder that gelform batch wrote.")],
    shown: ShownOption,
) -> None:
    """Check every output of a batch, and list problems.

    Lists missing, changed and extra files. `gelform batch verify` is the same command.

    The exit status is 1 if there is a problem. Frames that failed in the batch are counted, but are no problem of the
    output.

    \b
    Examples:
      gelform verify depth
      gelform verify depth --json
    """
    from gelform.batch import verify_output

    with shown.progress() as progress:
        good, errors, problems = verify_output(output, progress)
    shown.json({"frames": good, "errors": errors, "problems": list(map(asdict, problems))})
    for one in problems[:20]:
        say(f"gelform: error: {one.path}: {one.what}", shown.as_json)
    if more := problems[20:]:
        say(f"{len(more)} more; all with --json.", shown.as_json)
    say(
        f"complete: {counted(good, 'frame')}; with an error: {errors}; {counted(len(problems), 'problem')}.",
        shown.silent,
    )
    if problems:
        raise typer.Exit(MISTAKE)
