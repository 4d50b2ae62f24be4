"""Number of cases per property: a tenth without the slow tests, others and more with GELFORM_ROBUSTNESS_FACTOR=10.

The allowed outcomes of a call with bad input, and the function that judges them.

Allowed are an error of gelform that explains the fault, a finding, or a right result. Everything else is `Wrong`: an
error of another library, an unexplained error, a leaked warning, NaN, a silently wrong result.
"""

from __future__ import annotations

import dataclasses
import os
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

import gelform
from gelform import GelformError

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


SOURCE = str(Path(gelform.__file__).parent)
SHORTEST = 15
# Words of Python's and its libraries' own messages, which say nothing to who gave the input.
FOREIGN_WORDS = (
    "embedded null",
    "empty sequence",
    "codec can't",
    "has no attribute",
    "not subscriptable",
    "object is not",
    "unhashable",
    "out of range float",
    "could not be broadcast",
    "cannot reshape",
    "setting an array element",
    "OpenCV(",
    "unexpected keyword",
    "positional argument",
)
counts: Counter[str] = Counter()


class Wrong(AssertionError):
    """Neither an error of gelform's own, nor a finding, nor right."""


def judge(
    what: str, call: Callable[[], Any], right: Callable[[Any], str | None] = lambda result: None
) -> str:
    """Make a call and say how it ended: "error", "finding" or "right".

    Parameters
    ----------
    what : the case, for who reads the failure
    call : with bad input
    right : says what is wrong with a result, or None; a result must be finite besides

    Raises
    ------
    Wrong
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # How an older matplotlib uses a newer pyparsing is none of gelform's.
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        warnings.filterwarnings("error", category=DeprecationWarning, module="gelform")
        try:
            result = call()
        except Exception as problem:
            complaint, outcome = _of_error(problem), "error"
        else:
            complaint, outcome = _of_result(result, right)
    counts[outcome if complaint is None else "wrong"] += 1
    if complaint is not None:
        raise Wrong(f"{what}: {complaint}")
    return outcome


def _of_error(problem: Exception) -> str | None:
    frames = traceback.extract_tb(problem.__traceback__)
    own = [frame for frame in frames if frame.filename.startswith(SOURCE)]
    where = f"{Path(own[-1].filename).relative_to(SOURCE)}:{own[-1].name}" if own else "?"
    said = f"{type(problem).__name__}: {str(problem)[:200]} [{where}]"
    if not isinstance(problem, (GelformError, ValueError, TypeError)):
        return f"foreign error {said}"
    if not isinstance(problem, GelformError) and not frames[-1].filename.startswith(SOURCE):
        return f"error of another library {said}"
    message = str(problem)
    if len(message) < SHORTEST or any(word.lower() in message.lower() for word in FOREIGN_WORDS):
        return f"unexplained error {said}"
    return None


def _of_result(result: Any, right: Callable[[Any], str | None]) -> tuple[str | None, str]:
    if not is_finite(result):
        return "a result with NaN or infinity", ""
    if any(finding.name for finding in getattr(result, "health", ())):
        return None, "finding"
    return right(result), "right"


def is_finite(value: Any) -> bool:
    """No NaN and no infinity in arrays, numbers, records, and lists of them."""
    if isinstance(value, np.ndarray):
        return value.dtype.kind not in "fc" or bool(np.isfinite(value).all())
    if isinstance(value, (float, np.floating)):
        return bool(np.isfinite(value))
    if isinstance(value, Mapping):
        return all(is_finite(one) for one in value.values())
    if isinstance(value, (list, tuple)):
        return all(is_finite(one) for one in value)
    if dataclasses.is_dataclass(value):
        return all(is_finite(vars(value)[name]) for name in vars(value))
    return True
