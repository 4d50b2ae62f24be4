"""Processor time of a worker's frame by stage, compared with a bare loop's in the same minutes. See `batch.py`.

Processor time of one process depends less on other work of the machine than clock time. Each figure is a median over parts,
taken in turns.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import cv2

import gelform
from batch.rates import bare_loop
from gelform.batch import BatchSettings
from gelform.batch.inputs.listing import listing_of
from gelform.batch.inputs.plan import Part, plan_of
from gelform.batch.inputs.reading import frames_of_part, image_of_calibration
from gelform.batch.outputs.files import PartTarget, facts_of
from gelform.batch.outputs.writers import WRITERS
from gelform.batch.work import Job, Worker

PART = 64  # frames
STAGES = ("read", "reconstruct", "table", "encode", "write")


class Clock:
    """Processor time of this process by name, seconds."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def of_stage(self, name: str, stage: str) -> AbstractContextManager[None]:
        """Add the time of the block to a stage of a setting."""
        return self.of(f"{name}: {stage}")

    @contextmanager
    def of(self, name: str) -> Iterator[None]:
        """Add the time of the block."""
        begin = time.process_time()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.process_time() - begin


def stages_of_a_frame(folder: Path, settings: Mapping[str, BatchSettings], quick: bool) -> dict[str, Any]:
    """Milliseconds of processor time per frame, by stage, for each setting; and the ratio of bare loop to worker."""
    cv2.setNumThreads(1)
    parts = plan_of(listing_of(folder / "in"), PART)[: 3 if quick else 6]
    calibration = gelform.load_calibration(folder / "cal.npz")
    jobs = {
        name: Job(calibration, None, folder / f"out-{k}", one)
        for k, (name, one) in enumerate(settings.items())
    }
    clocks = [clock_of(jobs, part, folder / "bare") for part in [parts[0], *parts]][1:]  # the first prepares
    ms = {name: median(1e3 * clock.seconds[name] / PART for clock in clocks) for name in clocks[0].seconds}
    rows = [row_of(name, ms) for name in jobs]
    return {"frames": PART * len(parts), "bare_loop_ms": ms["bare"], "rows": rows}


def clock_of(jobs: Mapping[str, Job], part: Part, bare: Path) -> Clock:
    """Times of one part: in the bare loop, and for each job in a worker, stage by stage."""
    clock, paths = Clock(), [part.path / name for name in part.images]
    with emptied(bare), clock.of("bare"):
        bare_loop(paths, bare)
    for name, job in jobs.items():
        worker = Worker(job)
        worker._prepared(part)
        with emptied(job.output), clock.of(name):
            worker.do(part)
        with emptied(job.output):
            by_stage(worker, part, partial(clock.of_stage, name))
    return clock


def by_stage(worker: Worker, part: Part, of: Callable[[str], AbstractContextManager[None]]) -> None:
    """The steps of `Worker.do` for a frame, in its order."""
    job, frames, reconstruct = worker.job, frames_of_part(part), worker._prepared(part)
    facts = {"mm_per_px": job.calibration.mm_per_px, "calibration_digest": job.calibration.digest}
    place = PartTarget(job.output, part, job.settings, job.calibration.image_shape, facts)
    with WRITERS[job.settings.form].writer(place) as writer:
        for _ in part.images:
            with of("read"):
                named = next(frames)
            assert named.frame is not None
            with of("reconstruct"):
                result = reconstruct.from_image(image_of_calibration(named.frame, job.calibration))
            with of("table"):
                facts_of(result)
            with of("encode"):
                prepared = writer.prepared(result)
            with of("write"):
                writer.add(named.name, named.index, prepared)


def row_of(name: str, ms: Mapping[str, float]) -> dict[str, Any]:
    """A setting's figures."""
    by = {f"{stage}_ms": ms[f"{name}: {stage}"] for stage in STAGES}
    return {"settings": name, "frame_ms": ms[name], **by, "bare_over_frame": ms["bare"] / ms[name]}


@contextmanager
def emptied(folder: Path) -> Iterator[None]:
    """A new folder that is deleted after the block."""
    folder.mkdir()
    try:
        yield
    finally:
        shutil.rmtree(folder)
