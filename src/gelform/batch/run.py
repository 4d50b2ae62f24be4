"""A batch: list, plan, do the parts in this process, on several or on Ray, continue an interrupted run, and finish.

The work on one part is a pure function, and parts may end in any order. Ray's machines must see the same files under the
same paths.
"""

from __future__ import annotations

import os
import pickle
import secrets
import tempfile
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from itertools import islice
from multiprocessing.sharedctypes import RawValue
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform import DataError, Frame, Reconstructor
from gelform.batch.inputs import (
    Listing,
    Part,
    background_of_file,
    background_of_film,
    backgrounds_of,
    frames_of_part,
    image_of_calibration,
    listing_of,
    plan_of,
    shard_of,
)
from gelform.batch.outputs.files import (
    FRAMES,
    PARTS,
    SHEET,
    BatchSettings,
    PartTarget,
    PartWriter,
    check_names,
    facts_of,
    output_file,
    write_output,
)
from gelform.batch.outputs.lerobot import EPISODES, check_lerobot_source
from gelform.batch.outputs.writers import WRITERS, depth_of_row
from gelform.batch.records import (
    COLUMNS,
    TABLES,
    Manifest,
    PartRecord,
    begin,
    done_records,
    only_run,
    outputs_there,
    read_manifest,
    read_record,
    record_path,
    table_form,
    write_record,
    write_table,
)
from gelform.calibration.library import choose_calibration, unit_of_all
from gelform.calibration.starters import at_rest_again
from gelform.calibration_file import Calibration, as_calibration
from gelform.errors import FrameTally, GelformError, cannot, needed, reason
from gelform.exchange.exporters.press_folder import check_room
from gelform.foundations.checks import check_choice, check_path
from gelform.foundations.files import made_folder, picture_bytes
from gelform.foundations.processes import WorkerLostError, interrupt_held, worker_processes


class Stopped(Exception):
    """The run ends between two frames."""


@dataclass(frozen=True)
class Job:
    """The data that all parts share; plain, so that it can be sent to another process."""

    calibration: Calibration
    background: NDArray[Any] | None
    output: Path
    settings: BatchSettings
    background_files: Mapping[str, Path] = field(default_factory=dict)


class Worker:
    """Does parts one after the other; prepares the Reconstructor once, or once per film with its own background."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self._prepared_for: tuple[str | None, ...] = ()
        self._reconstruct: Any = None

    def do(self, part: Part, stop: Callable[[], bool] = bool) -> PartRecord:
        """Write the outputs of a part, then its record, with the same bytes each time; Stopped if `stop()` returns True."""
        job, calibration, digest, rows = self.job, self.job.calibration, part.input_digest(), []
        facts = {"mm_per_px": calibration.mm_per_px, "calibration_digest": calibration.digest}
        target = PartTarget(job.output, part, job.settings, calibration.image_shape, facts)
        with WRITERS[job.settings.form].writer(target) as writer:
            for index, frame in frames_of_part(part, calibration.most_pixels):
                if stop():
                    raise Stopped
                rows.append(self._row(part, index, frame, writer))
        record = PartRecord(digest, tuple(rows), tuple(writer.files))
        write_record(job.output, part.number, record)
        return record

    def _row(
        self, part: Part, index: int, frame: Frame | BaseException, writer: PartWriter
    ) -> dict[str, Any]:
        """Write a frame's output; return its row for the table and the record."""
        row: dict[str, Any] = dict.fromkeys(COLUMNS, "")
        row |= {"sequence": part.film.name, "frame": part.name_of(index), "index": index}
        error, prepared = "", None
        if isinstance(frame, Frame):
            times = {"time_s": frame.time_s, "wall_time_ns": frame.wall_time_ns} if part.film.is_timed else {}
            row |= times
            try:
                image = image_of_calibration(frame, self.job.calibration)
                result = self._prepared(part).from_image(image).changed(index=frame.index, **times)
                prepared, numbers = writer.prepared(result), facts_of(result)
                row |= numbers
            except (GelformError, MemoryError) as problem:
                error = reason(problem)
            except Exception as problem:  # a bug with one frame must not end a run of a million
                error = f"bug of gelform: {type(problem).__name__}: {problem}"
        else:
            error = reason(frame)
        row["error"] = " ".join(error.split())
        return row | writer.add(part.name_of(index), index, prepared)

    def _prepared(self, part: Part) -> Reconstructor:
        """The Reconstructor of a part's film; a refused background raises its error again."""
        job, name = self.job, part.film.name
        own = name if job.settings.background_frames or job.background_files else None
        if self._prepared_for != (own,):
            calibration, background = job.calibration, job.background
            try:
                if job.settings.background_frames:
                    background = background_of_film(part, job.settings.background_frames, calibration)
                    if calibration.settings.starter is not None:  # a film may be of another unit of the make
                        calibration, background = at_rest_again(calibration, background), None
                elif job.background_files:
                    background = background_of_file(job.background_files[name], calibration)
                self._reconstruct = Reconstructor(calibration, background)
            except GelformError as problem:
                self._reconstruct = problem
            self._prepared_for = (own,)  # not after a lack of memory, which may be over at the next frame
        if isinstance(self._reconstruct, GelformError):
            raise self._reconstruct
        return self._reconstruct


NOTHING_LOST = "What is done is kept, and not done again."
TRIES_AGAIN = 5  # repetitions of a part whose worker or machine is lost; its bytes are the same
Counts = tuple[int, int]  # frames of a part, and those with an error

_worker: Worker | None = None
_stop: Any = None
_run: str | None = None  # the Ray run that the worker was made for


def done_parts(
    job: Job, parts: Sequence[Part], workers: int, address: str | None = None
) -> Generator[Counts, None, None]:
    """Do parts in this process, or in several on this machine, without an address (see `ENGINES`)."""
    if workers == 1:
        worker = Worker(job)
        for part in parts:
            yield worker.do(part).counts
        return
    stop = RawValue("b", 0)  # without a lock, which a killed worker would hold forever
    with tempfile.TemporaryDirectory(prefix="gelform-batch-") as folder:
        shared = Path(folder) / "job"  # a file, because it may be large
        shared.write_bytes(pickle.dumps(job))
        with worker_processes(workers, _prepare, shared, stop, kept=NOTHING_LOST) as pool:
            try:
                with interrupt_held():
                    waiting = [pool.submit(_do, part) for part in parts]
                for future in as_completed(waiting):
                    yield future.result()
            finally:
                stop.value = 1


def done_parts_on_ray(
    job: Job, parts: Sequence[Part], workers: int, address: str | None = None
) -> Generator[Counts, None, None]:
    """Do parts as Ray tasks with one CPU each (see `ENGINES`); without an address, start Ray here."""
    ray = needed("ray", "ray", "The engine ray")
    with _connected(ray, workers, address):
        # It reserves memory for each task.
        do = ray.remote(num_cpus=1, memory=600 << 20, max_retries=TRIES_AGAIN)(_do_on_ray)
        run, shared, todo = secrets.token_hex(8), ray.put(job), iter(parts)
        # Two tasks for each CPU are queued: a worker never waits, and memory holds no million tasks.
        most = 2 * max(1, int(ray.cluster_resources().get("CPU", 1)))
        waiting: list[Any] = []
        try:
            while True:
                for part in islice(todo, most - len(waiting)):
                    waiting.append(do.remote(run, shared, part))
                if not waiting:
                    return
                (done,), waiting = ray.wait(waiting, num_returns=1)
                yield _result(ray, done)
        finally:
            for one in waiting:
                ray.cancel(one)
            ray.wait(waiting, num_returns=len(waiting), timeout=10) if waiting else None


# Does parts, at most so many at once; gives the counts of each as it is finished. Closing the generator ends the work
# between two frames; unfinished parts leave no record. Raises WorkerLostError if workers were killed, and DataError if an
# output cannot be written.
ENGINES: dict[str, Callable[..., Generator[Counts, None, None]]] = {
    "pool": done_parts,
    "ray": done_parts_on_ray,
}


@dataclass(frozen=True)
class Engine:
    """The engine, and the number of parts at once.

    Attributes
    ----------
    name : one of ENGINES
    workers : processes of the pool; CPUs of Ray if `address` is None
    address : address of a running Ray cluster, such as "auto" or "ray://head:10001"

    Raises
    ------
    ValueError
        The name is unknown, workers is below 1, or the pool got an address.
    """

    name: str = "pool"
    workers: int = 1
    address: str | None = None

    def __post_init__(self) -> None:
        check_choice(self.name, ENGINES, "an engine")
        if self.workers < 1:
            raise ValueError(f"Expected at least one worker, got {self.workers}.")
        if self.address is not None and self.name != "ray":
            raise ValueError(f"Expected an address with the engine ray, got one with {self.name}.")

    def done(self, job: Job, parts: Sequence[Part]) -> Generator[Counts, None, None]:
        """Do parts (see `ENGINES`)."""
        workers = min(self.workers, max(1, len(parts)))
        return ENGINES[self.name](job, parts, workers, self.address)


def _prepare(shared: Path, stop: Any) -> None:
    """Prepare a worker process for its first part."""
    global _worker, _stop
    _worker, _stop = Worker(pickle.loads(shared.read_bytes())), stop


def _do(part: Part) -> Counts:
    assert _worker is not None
    try:
        return _worker.do(part, lambda: bool(_stop.value)).counts
    except Stopped:
        return 0, 0


def _do_on_ray(run: str, job: Job, part: Part) -> Counts:
    """Do a part in a worker process of Ray; each worker prepares the Reconstructor once."""
    global _worker, _run
    if _worker is None or _run != run:
        cv2.setNumThreads(1)
        _worker, _run = Worker(job), run
    return _worker.do(part).counts


@contextmanager
def _connected(ray: Any, workers: int, address: str | None) -> Any:
    """Connect to Ray; an existing connection stays open."""
    if ray.is_initialized():
        yield
        return
    local = {"num_cpus": workers, "include_dashboard": False} if address is None else {"address": address}
    try:
        ray.init(log_to_driver=False, logging_level="ERROR", **local)
    except Exception as problem:  # Ray raises a plain Exception if one of its own processes does not start
        what = "start Ray here" if address is None else f"reach Ray at {address}"
        said = str(problem).rstrip(".")
        raise WorkerLostError(f"Cannot {what}: {said}. Look at: ray status.") from problem
    try:
        yield
    finally:
        ray.shutdown()


def _result(ray: Any, done: Any) -> Counts:
    """The result of a task; its errors are raised here unchanged."""
    lost = ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError, ray.exceptions.OutOfMemoryError
    try:
        counts: Counts = ray.get(done)
        return counts
    except ray.exceptions.RayTaskError as problem:
        if isinstance(problem.cause, GelformError):
            raise problem.cause from None
        raise
    except lost as problem:
        raise WorkerLostError(
            f"A part's worker was lost {TRIES_AGAIN + 1} times, perhaps for want of memory: {problem} {NOTHING_LOST} Run "
            "the same command again."
        ) from problem


Pitch = float | Sequence[float]
ACROSS, DOWN = 6, 4  # of the contact sheet: tiles per row, rows
TILE_PX, LABEL_PX, GAP_PX = 200, 50, 8  # width of a tile, height of the text below it, gap beside and below
GAP_LEVEL = 90  # gray level of gaps


def finish(
    output: Path, manifest: Manifest, table: str, source: Path, mm_per_px: Pitch | None = None
) -> None:
    """Write the files and their record, unless they are there; of the table, the form that was asked for."""
    done = read_record(output, None)
    if done is None or not outputs_there(output, done):
        for name in TABLES.values():  # of an earlier state of the parts
            (output / name).unlink(missing_ok=True)
        of_parts = [file.path for record in done_records(output, manifest.parts) for file in record.files]
        files = WRITERS[manifest.settings["form"]].finish(output, of_parts, source)
        sheet = sheet_bytes(output, manifest, mm_per_px)
        if sheet:
            files.append(write_output(output, output / SHEET, sheet))
    else:
        files = list(done.files)
    name = TABLES[table]
    if name not in {file.path for file in files}:
        write_table(output, manifest.parts, table)
        files.append(output_file(output, output / name))
        write_record(output, None, PartRecord("", (), tuple(files)))


def sheet_bytes(output: Path, manifest: Manifest, mm_per_px: Pitch | None = None) -> bytes:
    """The contact sheet of up to 24 random frames; empty if depth was not kept.

    The choice depends only on the list of inputs, so that the same data set gives the same sheet. Parts are drawn first, so
    that at most one record is read per frame.
    """
    rng = np.random.default_rng(int(manifest.listing_digest[:16], 16))
    numbers = np.sort(rng.permutation(manifest.parts)[: ACROSS * DOWN])
    frames = []
    for number in numbers.tolist():
        record = read_record(output, number)
        rows = [row for row in record.rows if row["output"]] if record else []
        for k in np.sort(rng.permutation(len(rows))[: -(-ACROSS * DOWN // len(numbers))]):
            row, depth = rows[k], depth_of_row(output, manifest.settings["form"], rows[k])
            if depth is not None:
                deepest_mm = row["deepest_mm"]  # no number if depth is known in no pixel
                deepest = f"{deepest_mm:.3f} mm" if isinstance(deepest_mm, float) else "unknown"
                frames.append((depth, f"{row['sequence']}/{row['frame']}", f"{deepest} {row['health']}"))
    return contact_sheet(frames[: ACROSS * DOWN], mm_per_px)


def contact_sheet(
    frames: Sequence[tuple[NDArray[Any], str, str]], mm_per_px: Pitch | None = None, unit: str = "mm"
) -> bytes:
    """A PNG of frames, each from 0 (dark) to its own deepest point, with a color bar and a scale; empty without frames.

    `frames` are depth (H, W) in a unit, name and note of each; `mm_per_px`, or (x, y), is of the images: None leaves out the
    scale.
    """
    pitch = None if mm_per_px is None else float(np.ravel(mm_per_px)[0])
    tiles = [_tile(*frame, pitch, unit) for frame in frames]
    if not tiles:
        return b""
    blank = np.zeros_like(tiles[0])
    blank[-GAP_PX:] = blank[:, -GAP_PX:] = GAP_LEVEL
    tiles += [blank] * (-len(tiles) % ACROSS)
    lines = [np.hstack(tiles[k : k + ACROSS]) for k in range(0, len(tiles), ACROSS)]
    return picture_bytes(np.vstack(lines)[..., ::-1])  # OpenCV colors tiles in BGR


def _tile(depth: NDArray[Any], name: str, note: str, pitch: float | None, unit: str) -> NDArray[np.uint8]:
    """Depth as colors with three lines below: color bar and scale, the frame's name, its deepest point and findings."""
    depth = np.nan_to_num(depth, nan=0.0)
    deepest = max(float(depth.max()), 0.1)  # mm; a gel at rest stays dark
    levels = np.clip(255 * depth / deepest, 0, 255).astype(np.uint8)
    height = round(TILE_PX * depth.shape[0] / depth.shape[1])
    small = cv2.resize(levels, (TILE_PX, height), interpolation=cv2.INTER_AREA)
    tile = np.vstack(
        [cv2.applyColorMap(small, cv2.COLORMAP_VIRIDIS), np.zeros((LABEL_PX, TILE_PX, 3), np.uint8)]
    )
    bar = np.linspace(0, 255, 60).astype(np.uint8)[None]
    tile[height + 6 : height + 14, 14:74] = cv2.applyColorMap(bar, cv2.COLORMAP_VIRIDIS)
    name = name.encode("ascii", "replace").decode()
    texts = [("0", 4, 14), (f"{deepest:.2f} {unit}", 78, 14), (name[-32:], 4, 30), (note[:32], 4, 44)]
    if pitch is not None:
        px_per_mm = TILE_PX / (depth.shape[1] * pitch)
        length_mm = max((one for one in (0.5, 1, 2, 5, 10) if one * px_per_mm <= 40), default=0.5)
        tile[height + 9 : height + 11, TILE_PX - round(length_mm * px_per_mm) - 2 : TILE_PX - 2] = 255
        texts.append((f"{length_mm:g} mm", TILE_PX - 42, 24))
    for text, x, y in texts:
        cv2.putText(
            tile, text, (x, height + y), cv2.FONT_HERSHEY_SIMPLEX, 0.36, (255, 255, 255), 1, cv2.LINE_AA
        )
    return cv2.copyMakeBorder(tile, 0, GAP_PX, 0, GAP_PX, cv2.BORDER_CONSTANT, value=[GAP_LEVEL] * 3)


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
    starter: Callable[[NDArray[Any]], Calibration] | None = None,
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
    starter : `calibration_from_background` of a make, if none was given; each sequence has one of its first frames

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
    listing = replace(listing_of(source, leave_out=backgrounds.files, dataset=dataset), bgr=settings.bgr)
    check_apart(listing, output)
    if starter is not None and given is None:
        count = settings.background_frames
        given = _with_scale(starter(background_of_film(plan_of(listing, 1, count)[0], count)))
    calibration = given or _with_scale(_choose_calibration(listing, output, options.overwrite, chosen))
    names = [sequence.name for sequence in listing.sequences]
    check_names(names, settings)
    if settings.form == "lerobot":
        check_lerobot_source(listing.root, {sequence.dataset for sequence in listing.sequences})
    plan = plan_of(listing, settings.frames_in_a_part, settings.background_frames)
    parts = shard_of(plan, options.shard)
    untouched, digest = backgrounds.read(names, calibration)
    _check_size(plan, calibration)
    images = sum(len(sequence.images) for sequence in listing.sequences)
    digests = calibration.digest, digest, listing.digest
    manifest = Manifest(settings.facts(), *digests, parts=len(plan), images=images)
    with cannot(f"write into {output}", "Give another output."):
        check_room(made_folder(output))
    with only_run(output, options.shard) as alone:
        begin(output, manifest, overwrite=options.overwrite)
        summary = BatchSummary(parts=len(parts), table=TABLES[table], warnings=listing.warnings)
        todo = list(_not_done(output, parts, summary, options.retry_errors))
        if todo:  # what an earlier run made of all parts will be out of date
            record_path(output, None).unlink(missing_ok=True)
        if alone:
            _clean(output, todo, settings.form)
        job = Job(calibration, untouched, output, settings, backgrounds.by_sequence)
        with closing(engine.done(job, todo)) as done:
            for frames, errors in done:
                summary.parts_done += 1
                summary.frames += frames
                summary.errors += errors
                progress(summary)
                summary.stopped = summary.errors > options.max_errors
                if summary.stopped:
                    break
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
    first = {part.film.name: part for part in reversed(plan)}
    problems = []
    for part in islice(reversed(first.values()), 5):
        index, frame = next(frames_of_part(part, calibration.most_pixels), (0, None))
        if not isinstance(frame, Frame):
            continue
        try:
            image_of_calibration(frame, calibration)
        except DataError as problem:
            problems.append(f"{part.film.path}, {part.name_of(index)}: {problem}")
        else:
            return
    if problems:
        raise DataError(
            f"{problems[0]} The calibration is of another size of frames: use the one of this sensor."
        )


def _not_done(
    output: Path, parts: Sequence[Part], summary: BatchSummary, retry_errors: bool
) -> Iterator[Part]:
    """Parts without a record, or whose inputs changed or outputs are missing; the others are counted."""
    for part in parts:
        record = read_record(output, part.number)
        if (
            record is None
            or record.input_digest != part.input_digest()
            or (retry_errors and record.errors)
            or not outputs_there(output, record)
        ):
            yield part
        else:
            summary.parts_done += 1
            summary.frames_before += len(record.rows)
            summary.errors += record.errors


def _clean(output: Path, todo: Sequence[Part], form: str) -> None:
    """Delete the temporary files of a killed run."""
    # LeRobot's copies more than the parts write, and keeps what they say of each episode in folders of its own.
    deep = {output / FRAMES, output / PARTS / EPISODES} if form == "lerobot" else set()
    shallow = {output / FRAMES / part.film.name for part in todo} - deep
    if form == "zarr":  # its shards are in folders of their own, and the groups above have files too
        above = {output / FRAMES / one for part in todo for one in PurePosixPath(part.film.name).parents}
        deep, shallow = shallow, above
    shallow |= {record_path(output, part.number).parent for part in todo} | {output, output / PARTS}
    left = [path for folder in shallow for path in folder.glob(".gelform-*.tmp")]
    left += [path for folder in deep for path in folder.rglob(".gelform-*.tmp")]
    for path in left:
        path.unlink(missing_ok=True)


def _count(output: Path, parts: Sequence[Part], tally: FrameTally) -> None:
    """Count the frames of the finished parts."""
    for record in filter(None, (read_record(output, part.number) for part in parts)):
        for row in record.rows:
            if row["error"]:
                tally.add_failed(row["error"])
            else:
                tally.add(row["health"].split(), known=row["deepest_mm"] != "")
