"""Time of a call relative to a bare transform; time and memory of the first weighted solve in a new process."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

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


def fresh_process(program: str) -> list[float]:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return [float(word) for word in done.stdout.split()]


def start_and_memory(large: bool) -> Table:
    """First weighted solve in a new process, imports included; peak memory at 2048x2048."""
    table: Table = {}
    for title in ("first", "again"):
        seconds, cpu = fresh_process(START)
        table[f"first weighted solve of a process, {title}"] = {"s": seconds, "CPU s": cpu}
    if large:
        before, after = fresh_process(MEMORY)
        table["memory at 2048x2048"] = {"MB in all": after, "MB by the solve": after - before}
    return table


def ratio(work: Callable[[], Any], bare: Callable[[], Any], repeats: int) -> tuple[float, float]:
    """CPU time of `work` relative to `bare`, and in ms: 10 % quantiles, measured alternately."""
    work(), bare()
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        bare()
        middle = time.thread_time()
        work()
        times.append((middle - start, time.thread_time() - middle))
    low = np.quantile(times, 0.1, axis=0)
    return float(low[1] / low[0]), float(1e3 * low[1])
