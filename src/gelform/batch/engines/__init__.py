"""What does the parts of a batch: this process and others of this machine, or Ray."""

from gelform.batch.engines.engine import ENGINES, Engine
from gelform.processes import WorkerLostError

__all__ = ["ENGINES", "Engine", "WorkerLostError"]
