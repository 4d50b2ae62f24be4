"""What the first weighted solve costs in a new process, and the memory of a large one."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

Table = dict[str, dict[str, float]]

START = """
import time
start = time.perf_counter(); cpu = time.process_time()
import numpy as np
import gelform
g = np.zeros((240, 320, 2), np.float32); w = np.ones((240, 320), np.float32)
g[..., 0] = np.linspace(0, 1, 320)
gelform.depth_from_gradients(g, mm_per_px=0.06, weights=w)
print(time.perf_counter() - start, time.process_time() - cpu)
"""

# What numba alone costs: its import and a function that its cache holds.
BARE = """
import time
start = time.perf_counter(); cpu = time.process_time()
import numpy as np
import gelform_bare
gelform_bare.one(np.zeros(3, np.float32))
print(time.perf_counter() - start, time.process_time() - cpu)
"""
BARE_MODULE = """
import numba

@numba.njit(cache=True)
def one(values):
    return values[0]
"""

MEMORY = """
import numpy as np
import gelform

def peak():
    # Not getrusage: a new process inherits that of the one that started it.
    line = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
    return float(line.split()[1]) / 1024

g = np.random.default_rng(0).standard_normal((2048, 2048, 2)).astype(np.float32)
before = peak()
gelform.depth_from_gradients(g, mm_per_px=0.06, weights=np.ones((2048, 2048), np.float32))
print(before, peak())
"""


def fresh_process(program: str, cache: str | None = None) -> list[float]:
    environment = dict(os.environ)
    if cache:
        path = os.pathsep.join([cache, environment.get("PYTHONPATH", "")])
        environment |= {"NUMBA_CACHE_DIR": cache, "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    return [float(word) for word in done.stdout.split()]


def start_and_memory(large: bool) -> Table:
    """First weighted solve in a new process, imports included; peak memory at 2048x2048."""
    table: Table = {}
    with tempfile.TemporaryDirectory() as cache:
        (Path(cache) / "gelform_bare.py").write_text(BARE_MODULE)
        for title in ("cold", "warm", "warm again"):
            for name, program in (("first weighted solve", START), ("numba alone", BARE)):
                seconds, cpu = fresh_process(program, cache)
                table[f"{name}, {title}"] = {"s": seconds, "CPU s": cpu}
    if large:
        before, after = fresh_process(MEMORY)
        table["memory at 2048x2048"] = {"MB in all": after, "MB by the solve": after - before}
    return table
