"""Shared parts of all benchmarks: the machine, the bare DCT pair as unit of time, tables, JSON."""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
from scipy.fft import dctn, idctn

import gelform

RESULTS = Path(__file__).parent / "results"


def machine() -> dict[str, str]:
    """Processor, versions and date, which belong to every figure."""
    model = platform.processor()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = [line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        model = lines[0].split(":", 1)[1].strip() if lines else model
    return {
        "processor": model,
        "cores": str(os.cpu_count()),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "gelform": gelform.__version__,
        "date": datetime.now(timezone.utc).date().isoformat(),
    }


def command_line(doc: str) -> argparse.ArgumentParser:
    """A command whose help is its script's docstring."""
    return argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)


def parts_asked(command: argparse.ArgumentParser, parts: Iterable[str]) -> argparse.Namespace:
    """What the user typed; `parts` are the names that were given, or all."""
    known = list(parts)
    command.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(known)}; all by default")
    asked = command.parse_args()
    if unknown := [name for name in asked.parts if name not in known]:
        command.error(f"no part {', '.join(unknown)}: expected {', '.join(known)}")
    asked.parts = asked.parts or known
    return asked


def dct_pair(shape: tuple[int, int]) -> Callable[[], Any]:
    """The unit of time D: a bare float32 scipy dctn + idctn pair of that size."""
    values = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    return lambda: idctn(dctn(values))


def median_ms(
    calls: Sequence[Callable[[], Any]],
    *,
    rounds: int = 31,
    seconds: float = 20,
    clock: Callable[[], float] = time.perf_counter,
) -> list[float]:
    """Median time of each call, ms; the calls alternate, so that a slow moment of the machine affects all."""
    for call in calls:
        call()
    times: list[list[float]] = [[] for _ in calls]
    end = time.perf_counter() + seconds
    for round_ in range(rounds):
        for call, of_call in zip(calls, times):
            start = clock()
            call()
            of_call.append(1e3 * (clock() - start))
        if time.perf_counter() > end and round_ >= 4:
            break
    return [float(np.median(of_call)) for of_call in times]


def table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(_cell(value) for value in row) + " |" for row in rows]
    return "\n".join(lines)


def recorded(name: str) -> dict[str, Any]:
    """The present figures of `results/<name>.json`, without the machine; a new measurement replaces its own part."""
    path = RESULTS / f"{name}.json"
    figures: dict[str, Any] = json.loads(path.read_text()) if path.is_file() else {}
    figures.pop("machine", None)
    return figures


def write(name: str, figures: dict[str, Any]) -> None:
    """Write `results/<name>.json` with the machine and the date."""
    RESULTS.mkdir(exist_ok=True)
    content = json.dumps({"machine": machine(), **figures}, indent=1, default=float)
    temporary = RESULTS / f".{name}.tmp"
    temporary.write_text(content + "\n")
    os.replace(temporary, RESULTS / f"{name}.json")


def write_part(name: str, part: str, figures: dict[str, Any]) -> None:
    """Write a separately measured part of `results/<name>.json`, with its own machine and date."""
    path = RESULTS / f"{name}.json"
    whole = json.loads(path.read_text()) if path.is_file() else {}
    whole[part] = {"machine": machine(), **figures}
    temporary = RESULTS / f".{name}.tmp"
    temporary.write_text(json.dumps(whole, indent=1, default=float) + "\n")
    os.replace(temporary, path)


def _cell(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
