"""A cold start is announced before it begins, a warm one is not."""

from __future__ import annotations

import os
import subprocess
import sys

from gelform.solvers.warmup import MESSAGE, is_compiled, warmup

PROGRAM = """
from gelform.solvers.warmup import is_compiled, warmup

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
