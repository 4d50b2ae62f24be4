"""A batch from its input to its table: list, plan, do the parts, and continue an interrupted run."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any

from gelform.batch.engines import Engine
from gelform.batch.finish import finish
from gelform.batch.inputs.listing import Listing, listing_of
from gelform.batch.inputs.plan import Part, plan_of, shard_of
from gelform.batch.inputs.reading import backgrounds_of, frames_of_part, image_of_calibration
from gelform.batch.manifest import Manifest, begin, only_run, read_manifest
from gelform.batch.outputs.files import FRAMES, PARTS, check_names
from gelform.batch.outputs.lerobot import EPISODES, check_lerobot_source
from gelform.batch.records import TABLES, outputs_there, read_record, record_path, table_form
from gelform.batch.settings import BatchSettings
from gelform.batch.work import Job
from gelform.calibration.library.choose import choose_calibration, unit_of_all
from gelform.calibration_file import Calibration, as_calibration
from gelform.errors import DataError
from gelform.exchange.exporters.folders import check_room
from gelform.foundations.checks import check_path
from gelform.foundations.findings import FrameTally

LOOKED_AT = 5  # sequences that are checked for frames of the calibrated size
LEFTOVERS = ".gelform-*.tmp"


@dataclass(frozen=True)
class RunOptions:
    """The parts that a run does, and its limit of errors.

    Attributes
    ----------
    max_errors : frames with errors; more end the run
    retry_errors : repeat parts with failed frames
    overwrite : start again if the output was started with other inputs or settings
    shard : (i, N): only every N-th part, from the i-th; shards may run at the same time
    """

    max_errors: int = 1000
    retry_errors: bool = False
    overwrite: bool = False
    shard: tuple[int, int] = (1, 1)


@dataclass
class BatchSummary:
    """The progress of a run, and its end.

    Attributes
    ----------
    parts, parts_done : of this shard, including parts of earlier runs
    frames : frames of this run, including those with errors
    frames_before : frames of earlier runs
    errors : frames with errors, in this run and before
    stopped : whether there were more errors than allowed
    table : name of the table
    warnings : messages about the input for the user
    complete : whether all parts of all shards are done and the table is written
    tally : findings and errors of this shard's frames, also of earlier runs; empty until the run ends
    """

    parts: int = 0
    parts_done: int = 0
    frames: int = 0
    frames_before: int = 0
    errors: int = 0
    stopped: bool = False
    table: str = ""
    warnings: tuple[str, ...] = ()
    complete: bool = False
    tally: FrameTally = field(default_factory=FrameTally)


def run_batch(
    source: str | os.PathLike[str],
    calibration: Calibration | str | os.PathLike[str] | None,
    output: str | os.PathLike[str],
    settings: BatchSettings | None = None,
    *,
    background: str | os.PathLike[str] | None = None,
    dataset: str = "",
    table: str = "auto",
    engine: Engine | None = None,
    options: RunOptions | None = None,
    progress: Callable[[BatchSummary], Any] = lambda _: None,
    chosen: Callable[[str], Any] = lambda _: None,
) -> BatchSummary:
    """Reconstruct every frame of a data set into an output folder; the same call continues an interrupted run.

    Parameters
    ----------
    source : see `listing_of`
    calibration : of the sensor, with a scale. None: the library's calibration of the unit that the input names; a continued
        run uses the one that it started with
    output : a new folder, or one that the same call started
    settings : BatchSettings; None: the defaults
    background : an image or a folder of the gel at rest, for all sequences; or a CSV table of `sequence,background`
    dataset : place of the frames in HDF5, Zarr or LeRobot (see `listing_of`)
    table : "parquet", "csv", or "auto": Parquet if pyarrow is installed
    engine : does the parts; None: this process
    options : parts to do, and the limit of errors; None: all parts
    progress : called with the BatchSummary after each part
    chosen : called with a sentence about the calibration, if none was given

    Raises
    ------
    DataError
        There is no input; the output is unusable or was started with other inputs or settings; or no frame has the
        calibration's size.
    WorkerLostError
        A worker was killed.
    """
    settings, options, output = settings or BatchSettings(), options or RunOptions(), check_path(output)
    table, engine = table_form(table), engine or Engine()
    given = None if calibration is None else _with_scale(as_calibration(calibration))
    if options.overwrite and options.shard[1] > 1:
        raise DataError(
            "A shard cannot overwrite what the others write. Delete the output, then start them all."
        )
    if background is not None and settings.background_frames:
        raise DataError("Expected --background or --background-frames, got both. Leave one out.")
    backgrounds = backgrounds_of(None if background is None else check_path(background))
    listing = listing_of(source, leave_out=backgrounds.files, dataset=dataset)
    check_apart(listing, output)
    calibration = given or _with_scale(_choose_calibration(listing, output, options.overwrite, chosen))
    check_names([sequence.name for sequence in listing.sequences], settings)
    if settings.form == "lerobot":
        check_lerobot_source(listing.root, {sequence.dataset for sequence in listing.sequences})
    plan = plan_of(listing, settings.frames_in_a_part, settings.background_frames, settings.bgr)
    parts = shard_of(plan, options.shard)
    untouched, digest = backgrounds.read([sequence.name for sequence in listing.sequences], calibration)
    _check_size(plan, calibration)
    images = sum(len(sequence.images) for sequence in listing.sequences)
    digests = calibration.digest, digest, listing.digest
    manifest = Manifest(settings.facts(), *digests, parts=len(plan), images=images)
    _make_folder(output)
    with only_run(output, options.shard) as alone:
        begin(output, manifest, overwrite=options.overwrite)
        summary = BatchSummary(parts=len(parts), table=TABLES[table], warnings=listing.warnings)
        todo = list(_not_done(output, parts, summary, options.retry_errors))
        if todo:  # what an earlier run made of all parts will be out of date
            record_path(output, None).unlink(missing_ok=True)
        if alone:
            _clean(output, todo, settings.form)
        job = Job(calibration, untouched, output, settings, backgrounds.by_sequence)
        _do(job, todo, engine, options.max_errors, summary, progress)
        _count(output, parts, summary.tally)
        if not summary.stopped and all(record_path(output, part.number).exists() for part in plan):
            finish(output, manifest, table, listing.root, calibration.mm_per_px)
            summary.complete = True
    return summary


def _with_scale(calibration: Calibration) -> Calibration:
    if calibration.mm_per_px is None:
        raise DataError(
            "This calibration has no scale, so there is no depth in mm. Import it again with --mm-per-px F."
        )
    return calibration


def _choose_calibration(
    listing: Listing, output: Path, anew: bool, said: Callable[[str], Any]
) -> Calibration:
    """The library's calibration of the unit that the input names; a continued run keeps the one that it started with."""
    unit = unit_of_all(sequence.path for sequence in listing.sequences)
    begun = None if anew else read_manifest(output)
    if begun is not None:
        unit = replace(unit, digest=begun.calibration_digest, carries=None)
    choice = choose_calibration(unit)
    said(choice.said)
    return choice.calibration


def check_apart(listing: Listing, output: Path) -> None:
    """Refuse (DataError) an output inside the input, where the next run would find it, or an input inside the output."""
    there = Path(os.path.realpath(output))
    folders = {Path(os.path.realpath(one.path)) for one in listing.sequences}
    searched = {Path(os.path.realpath(listing.root))} if listing.searched else set()
    if there in folders or searched & {there, *there.parents}:
        raise DataError(f"The output {output} is inside the input {listing.root}. Give a folder outside it.")
    if any(there in folder.parents for folder in folders):
        raise DataError(f"The input {listing.root} is inside the output {output}. Give a folder outside it.")


def _check_size(plan: Sequence[Part], calibration: Calibration) -> None:
    """Refuse, before writing anything, an input without frames of the calibrated size."""
    first = {part.sequence: part for part in reversed(plan)}
    problems = []
    for part in islice(reversed(first.values()), LOOKED_AT):
        named = next(frames_of_part(part, calibration.most_pixels), None)
        if named is None or named.frame is None:
            continue
        try:
            image_of_calibration(named.frame, calibration)
        except DataError as problem:
            problems.append(f"{part.path}, {named.name}: {problem}")
        else:
            return
    if problems:
        raise DataError(
            f"{problems[0]} The calibration is of another size of frames: use the one of this sensor."
        )


def _make_folder(output: Path) -> None:
    """Make the output folder and check that the disk has room, before the work."""
    try:
        output.mkdir(parents=True, exist_ok=True)
        check_room(output)
    except FileExistsError as problem:
        raise DataError(f"Expected a folder to write to, got the file {output}.") from problem
    except OSError as problem:
        raise DataError(f"Cannot write into {output}: {problem.strerror}. Give another output.") from problem


def _not_done(
    output: Path, parts: Sequence[Part], summary: BatchSummary, retry_errors: bool
) -> Iterator[Part]:
    """Parts without a record, or whose inputs changed or outputs are missing; the others are counted."""
    for part in parts:
        record = read_record(output, part.number)
        valid = record is not None and record.input_digest == part.input_digest()
        if (
            record is None
            or not valid
            or (retry_errors and record.errors)
            or not outputs_there(output, record)
        ):
            yield part
            continue
        summary.parts_done += 1
        summary.frames_before += len(record.rows)
        summary.errors += record.errors


def _clean(output: Path, todo: Sequence[Part], form: str) -> None:
    """Delete the temporary files of a killed run."""
    # LeRobot's copies more than the parts write, and keeps what they say of each episode in folders of its own.
    deep = {output / FRAMES, output / PARTS / EPISODES} if form == "lerobot" else set()
    shallow = {output / FRAMES / part.sequence for part in todo} - deep
    if form == "zarr":  # its shards are in folders of their own, and the groups above have files too
        above = {output / FRAMES / one for part in todo for one in PurePosixPath(part.sequence).parents}
        deep, shallow = shallow, above
    shallow |= {record_path(output, part.number).parent for part in todo} | {output, output / PARTS}
    for folders, pattern in ((deep, f"**/{LEFTOVERS}"), (shallow, LEFTOVERS)):
        for left in (one for folder in folders for one in folder.glob(pattern)):
            left.unlink(missing_ok=True)


def _count(output: Path, parts: Sequence[Part], tally: FrameTally) -> None:
    """Count the frames of the finished parts."""
    for record in filter(None, (read_record(output, part.number) for part in parts)):
        for row in record.rows:
            if row["error"]:
                tally.add_failed(row["error"])
            else:
                tally.add(row["health"].split(), known=row["deepest_mm"] != "")


def _do(
    job: Job,
    todo: Sequence[Part],
    engine: Engine,
    max_errors: int,
    summary: BatchSummary,
    progress: Callable[[BatchSummary], Any],
) -> None:
    with closing(engine.done(job, todo)) as done:
        for _, frames, errors in done:
            summary.parts_done += 1
            summary.frames += frames
            summary.errors += errors
            progress(summary)
            if summary.errors > max_errors:
                summary.stopped = True
                return
