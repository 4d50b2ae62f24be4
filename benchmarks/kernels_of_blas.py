"""The tests on each of OpenBLAS's kernels that this processor runs, with one and two threads.

    python benchmarks/kernels_of_blas.py                        # all fast tests, a table: ten minutes a kernel on two cores
    python benchmarks/kernels_of_blas.py -m linear_algebra      # those that rest on LAPACK
    python benchmarks/kernels_of_blas.py -m linear_algebra --quick   # each kernel once, the last with two: .ci/run

With --quick, Zen is left out: its kernels are Haswell's, to the bit.

numpy and scipy round differently from kernel to kernel, so a matrix that is singular on one is nearly so on another. Where
OpenBLAS is not used, or on another kind of processor, only the default is tried. Ends with 1 if a run fails.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).parents[1]
NEEDS = {
    "Nehalem": "sse4_2",
    "Haswell": "avx2",
    "Zen": "avx2",
    "SkylakeX": "avx512dq",
}  # Linux's names of what they use


def usable_kernels() -> list[str]:
    """The kernels that this processor runs, "" for the default where none can be chosen."""
    facts = Path("/proc/cpuinfo")
    flags = facts.read_text().partition("flags")[2].partition("\n")[0].split() if facts.exists() else []
    return [name for name, flag in NEEDS.items() if flag in flags] or [""]


def environment(kernel: str, threads: int) -> dict[str, str]:
    """The variables of a process that computes so."""
    own = {name: value for name, value in os.environ.items() if not name.startswith("OPENBLAS_")}
    chosen = {"OPENBLAS_CORETYPE": kernel} if kernel else {}
    return own | chosen | {"OPENBLAS_NUM_THREADS": str(threads), "OMP_NUM_THREADS": str(threads)}


def main() -> int:
    arguments = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    arguments.add_argument("-m", dest="marked", default="", help="also only tests of this mark")
    arguments.add_argument(
        "--kernels", nargs="+", default=usable_kernels(), help="default: all that run here"
    )
    arguments.add_argument("--threads", nargs="+", type=int, default=[1, 2])
    arguments.add_argument(
        "--quick", action="store_true", help="one thread on all kernels but the last, more on that one"
    )
    asked = arguments.parse_args()
    chosen = f"not slow and {asked.marked}" if asked.marked else "not slow"
    # Only files that name the mark are imported, which takes a while for all of them.
    all_files = sorted((ROOT / "tests").rglob("test_*.py"))
    files = [str(path) for path in all_files if asked.marked in path.read_text(encoding="utf-8")]

    def run(case: tuple[str, int]) -> tuple[int, str]:
        command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-m", chosen, *files]
        start, variables = time.perf_counter(), environment(*case)
        done = subprocess.run(command, cwd=ROOT, env=variables, capture_output=True, text=True, check=False)
        failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
        if done.returncode and not failed:
            failed = [done.stdout[-2000:] + done.stderr[-2000:]]
        ended = f"{len(failed)} failed" if failed else "passed"
        row = f"{case[0] or 'default':8} {case[1]:8} {time.perf_counter() - start:6.0f} s  {ended}"
        return done.returncode, "\n".join([row, *failed])

    print(f"{'kernel':8} threads     time  {chosen}")
    status = 0
    for threads in asked.threads:
        kernels = asked.kernels
        if asked.quick:
            kernels = [kernel for kernel in kernels if kernel != "Zen"]
            kernels = kernels[-1:] if threads > 1 else kernels[:-1]
        # Threads of OpenBLAS that wait for a processor keep another one busy.
        with ThreadPoolExecutor(max(1, (os.cpu_count() or 1) // threads)) as pool:
            for code, row in pool.map(run, [(kernel, threads) for kernel in kernels]):
                print(row, flush=True)
                status = max(status, int(code != 0))
    return status


if __name__ == "__main__":
    sys.exit(main())
