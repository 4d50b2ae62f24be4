"""How the untouched gel looks by now: what changes slowly where nothing touches, and nothing else."""

from gelform.streams.rest.background_drift import BackgroundDrift

__all__ = ["BackgroundDrift"]
