"""How many cases each property gets: few in CI, many where `benchmarks/robustness.py` asks for them."""

from __future__ import annotations

import os

from hypothesis import HealthCheck, settings

FACTOR = float(os.environ.get("GELFORM_ROBUSTNESS_FACTOR", "1"))


def cases(count: int) -> settings:
    """Settings of a property that CI tries `count` times, always the same ones; a larger budget tries others."""
    return settings(
        max_examples=max(1, round(count * FACTOR)),
        derandomize=FACTOR == 1,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
