"""The seam of engines: parts in, counts out, in whatever order they end."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Protocol

from gelform.batch.engines.processes import done_parts
from gelform.batch.engines.ray_tasks import done_parts_on_ray
from gelform.batch.inputs.plan import Part
from gelform.batch.work import Job


class DoneParts(Protocol):
    """Does parts; gives each with its number of frames and of errors as it is done.

    Closing the iterator ends the work between two frames; parts that are not done leave no record. Raises WorkerLostError
    where workers were killed, DataError where an output cannot be written.
    """

    def __call__(
        self, job: Job, parts: Sequence[Part], workers: int, address: str | None = None
    ) -> Generator[tuple[Part, int, int], None, None]: ...


ENGINES: dict[str, DoneParts] = {"pool": done_parts, "ray": done_parts_on_ray}


@dataclass(frozen=True)
class Engine:
    """Which engine, and how many parts at once.

    Attributes
    ----------
    name : one of ENGINES
    workers : processes of the pool; CPUs of Ray, where `address` is None
    address : of a Ray cluster that runs, such as "auto" or "ray://head:10001"

    Raises
    ------
    ValueError
        Another name, fewer workers than one, or an address for the pool.
    """

    name: str = "pool"
    workers: int = 1
    address: str | None = None

    def __post_init__(self) -> None:
        if self.name not in ENGINES:
            raise ValueError(f"Expected an engine among {', '.join(ENGINES)}, got {self.name!r}.")
        if self.workers < 1:
            raise ValueError(f"Expected at least one worker, got {self.workers}.")
        if self.address is not None and self.name != "ray":
            raise ValueError(f"Expected an address with the engine ray, got one with {self.name}.")

    def done(self, job: Job, parts: Sequence[Part]) -> Generator[tuple[Part, int, int], None, None]:
        """Do parts (see `DoneParts`)."""
        workers = min(self.workers, max(1, len(parts)))
        return ENGINES[self.name](job, parts, workers, self.address)
