"""Data sets: every frame of a folder tree, of videos and recordings to depth, on several processes, resumable."""

from gelform.batch.inputs import Listing, listing_of
from gelform.batch.outputs.files import KEPT, BatchSettings
from gelform.batch.records import Problem, verify_output
from gelform.batch.run import BatchSummary, Engine, RunOptions, run_batch
from gelform.sensors.containers import FilmRef

__all__ = [
    "KEPT",
    "BatchSettings",
    "BatchSummary",
    "Engine",
    "FilmRef",
    "Listing",
    "Problem",
    "RunOptions",
    "listing_of",
    "run_batch",
    "verify_output",
]
