"""A cold start is announced, a warm one is not."""

from __future__ import annotations

import os
import subprocess
import sys

PROGRAM = """
from gelform.solvers.warmup import is_compiled, warmup
told = []
before = is_compiled()
warmup(told.append)
print(before, is_compiled(), len(told))
"""


def run(cache):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


def test_says_when_it_compiles_and_only_then(tmp_path):
    assert run(tmp_path) == ["False", "True", "1"]
    assert run(tmp_path) == ["True", "True", "0"]
