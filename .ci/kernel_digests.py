"""A pytest plugin that writes down what every call of a C kernel gave, and the comparison of two such files.

    KERNEL_DIGESTS=here.txt python -m pytest -p kernel_digests tests/depth/solvers
    python .ci/kernel_digests.py here.txt there.txt     # 1 where the same input gave other bits

A line is the kernel's name, a digest of all that went in and one of all that came out. Memory that C owns counts by
what went into it before.
"""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path


def pytest_configure(config):
    """Wrap `Kernel` and `Handle`."""
    import numpy as np

    from gelform._native import Handle, Kernel

    call, init = Kernel.__call__, Handle.__init__
    file = open(os.environ["KERNEL_DIGESTS"], "w", encoding="utf-8")  # noqa: SIM115 (open until the run ends)

    def digest(values) -> str:
        found = hashlib.sha256()
        for value in values:
            if isinstance(value, np.ndarray):
                found.update(f"{value.dtype} {value.shape}".encode() + value.tobytes())
            else:
                found.update(repr(getattr(value, "history", value)).encode())
        return found.hexdigest()[:20]

    def remembered(handle, name, *sizes):
        init(handle, name, *sizes)
        handle.history = digest([name, *sizes])

    def recorded(kernel, *arguments):
        told = [(p, a) for p, a in zip(kernel.parameters, arguments) if p.name != "work"]
        entered = digest([a for _, a in told])
        status = call(kernel, *arguments)
        left = digest([status, *(a for p, a in told if p.role == "out")])
        for p, a in told:
            if p.is_handle:
                a.history = digest([a.history, kernel.name, entered])
        file.write(f"{kernel.name} {entered} {left}\n")
        file.flush()
        return status

    Kernel.__call__, Handle.__init__ = recorded, remembered


def main(first: str, second: str) -> int:
    """Compare two files."""
    runs = []
    for path in (first, second):
        run: dict[tuple[str, str], set[str]] = {}
        for line in Path(path).read_text(encoding="utf-8").splitlines():
            name, entered, left = line.split()
            run.setdefault((name, entered), set()).add(left)
        runs.append(run)
    common = sorted(set(runs[0]) & set(runs[1]))
    differing = [key for key in common if len(runs[0][key] | runs[1][key]) > 1]
    kernels = {name for name, _ in common}
    unseen = sorted({name for run in runs for name, _ in run} - kernels)
    print(f"same input on both: {len(common)} calls of {len(kernels)} kernels; other bits: {len(differing)}")
    if unseen:
        print("never with the same input:", ", ".join(unseen))
    for name in sorted({name for name, _ in differing}):
        print(f"wrong: {name} gave other bits")
    return 1 if differing or not common else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
