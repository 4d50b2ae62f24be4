"""Number of cases per property: a tenth without the slow tests, others and more with GELFORM_ROBUSTNESS_FACTOR=10."""

from __future__ import annotations

import os

import pytest
from hypothesis import HealthCheck, settings

FACTOR = float(os.environ.get("GELFORM_ROBUSTNESS_FACTOR", "1"))
SLOW_IF_ALL = [pytest.mark.slow] if FACTOR >= 1 else []


def cases(count: int) -> settings:
    """Settings of a property that is tried `count` times, always the same ones; a larger budget tries others."""
    return settings(
        max_examples=max(1, round(count * FACTOR)),
        derandomize=FACTOR <= 1,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
