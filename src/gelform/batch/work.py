"""The work on one part: a pure function of its input, the calibration and the settings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from gelform.batch.inputs.plan import Part
from gelform.batch.inputs.reading import (
    NamedFrame,
    background_of_file,
    background_of_sequence,
    frames_of_part,
    image_of_calibration,
)
from gelform.batch.outputs.files import PartTarget, PartWriter, facts_of
from gelform.batch.outputs.writers import WRITERS
from gelform.batch.records import COLUMNS, PartRecord, write_record
from gelform.batch.settings import BatchSettings
from gelform.calibration_file import Calibration
from gelform.errors import GelformError, reason
from gelform.reconstruct import Reconstructor
from gelform.result import Reconstruction


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
    """Does parts one after the other; prepares the Reconstructor once, or once per sequence with its own background."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self._prepared_for: tuple[str | None, ...] = ()
        self._reconstruct: Any = None

    def do(self, part: Part, stop: Callable[[], bool] = bool) -> PartRecord:
        """Write the outputs of a part, then its record, with the same bytes each time; Stopped if `stop()` returns True."""
        digest, rows = part.input_digest(), []
        with WRITERS[self.job.settings.form].writer(self._target(part)) as writer:
            for named in frames_of_part(part, self.job.calibration.most_pixels):
                if stop():
                    raise Stopped
                rows.append(self._row(part, named, writer))
        record = PartRecord(digest, tuple(rows), tuple(writer.files))
        write_record(self.job.output, part.number, record)
        return record

    def _target(self, part: Part) -> PartTarget:
        calibration = self.job.calibration
        facts = {"mm_per_px": calibration.mm_per_px, "calibration_digest": calibration.digest}
        return PartTarget(self.job.output, part, self.job.settings, calibration.image_shape, facts)

    def _row(self, part: Part, named: NamedFrame, writer: PartWriter) -> dict[str, Any]:
        """Write a frame's output; return its row for the table and the record."""
        row: dict[str, Any] = dict.fromkeys(COLUMNS, "")
        row |= {"sequence": part.sequence, "frame": named.name, "index": named.index}
        error, prepared, facts = named.error, None, {}
        if named.frame is not None:
            if named.timed:
                row |= {"time_s": named.frame.time_s, "wall_time_ns": named.frame.wall_time_ns}
            try:
                result = self._result(part, named)
                prepared, facts = writer.prepared(result), facts_of(result)
            except (GelformError, MemoryError) as problem:
                error = reason(problem)
            except Exception as problem:  # a bug with one frame must not end a run of a million
                error = f"bug of gelform: {type(problem).__name__}: {problem}"
        row |= {**facts, "error": " ".join(error.split())} if prepared is None else facts
        return row | writer.add(named.name, named.index, prepared)

    def _result(self, part: Part, named: NamedFrame) -> Reconstruction:
        frame = named.frame
        assert frame is not None
        image = image_of_calibration(frame, self.job.calibration)
        result = self._prepared(part).from_image(image)
        times = {"time_s": frame.time_s, "wall_time_ns": frame.wall_time_ns} if named.timed else {}
        return result.changed(index=frame.index, **times)

    def _prepared(self, part: Part) -> Reconstructor:
        """The Reconstructor of a part's sequence; a refused background raises its error again."""
        per_sequence = self.job.settings.background_frames or self.job.background_files
        own = part.sequence if per_sequence else None
        if self._prepared_for != (own,):
            self._prepared_for = (own,)
            try:
                self._reconstruct = self._with_background(part)
            except GelformError as problem:
                self._reconstruct = problem
        if isinstance(self._reconstruct, GelformError):
            raise self._reconstruct
        return self._reconstruct

    def _with_background(self, part: Part) -> Reconstructor:
        settings, background = self.job.settings, self.job.background
        if settings.background_frames:
            background = background_of_sequence(part, settings.background_frames, self.job.calibration)
        elif self.job.background_files:
            background = background_of_file(self.job.background_files[part.sequence], self.job.calibration)
        return Reconstructor(
            self.job.calibration,
            background=background,
            solver=settings.solver,
        )
