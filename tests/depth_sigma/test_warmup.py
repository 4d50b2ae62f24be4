"""A cold start is announced before it begins, a warm one is not."""

from __future__ import annotations

import os
import subprocess
import sys

from numba import njit

from gelform.depth_sigma.warmup import MESSAGE, SLOW, is_compiled, warmup

PROGRAM = """
from gelform.depth_sigma.warmup import is_compiled, warmup

print(is_compiled())

def stop(message):
    raise SystemExit("told: " + message)

warmup(stop)
"""


def test_tells_before_it_compiles(tmp_path):
    """In a new process whose cache is empty; stopped when told, because compiling takes long."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == ["False"]
    assert done.stderr.strip() == f"told: {MESSAGE}"


def test_has_nothing_to_tell_once_compiled():
    warmup()
    told = []
    warmup(told.append)
    assert is_compiled()
    assert told == []


@njit(cache=True)
def never_called():
    return 0


def test_one_kernel_not_compiled_is_enough_to_tell(monkeypatch):
    """Among them those of `depth_sigma`, which may be missing where depth alone was asked for before."""
    warmup()
    assert {kernel.py_func.__name__ for kernel in SLOW} >= {
        "build",
        "solve_lanes",
        "sigma_of_pixels",
    }
    monkeypatch.setattr(sys.modules[warmup.__module__], "SLOW", (*SLOW, never_called))
    told = []
    warmup(told.append)
    assert told == [MESSAGE]
