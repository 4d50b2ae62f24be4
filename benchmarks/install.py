"""What a new user waits for: pip install without a C compiler, the size of it, the first frame, the demo.

    python benchmarks/install.py            # about 3 minutes, in a new virtual environment; writes results/install.json

Seconds are of this machine and of the package index that pip reads from, so the same environment without gelform
is timed beside it: what pip takes for the dependencies alone.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from report import table, write

ROOT = Path(__file__).parents[1]
DEPENDENCIES = ["numpy", "scipy", "opencv-python-headless", "simplejpeg", "tomlkit", "typer", "rich"]
FRAMES = 5


def timed(command: list[str], folder: Path, path: str) -> float:
    """Seconds that a command takes with these programs alone, no compiler of this machine among them."""
    hidden = {"PYTHONPATH", "CC", "VIRTUAL_ENV"}
    environment = {**{k: v for k, v in os.environ.items() if k not in hidden}, "PATH": path}
    started = time.perf_counter()
    subprocess.run(command, cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started


def new_environment(folder: Path) -> Path:
    """The programs of a new virtual environment."""
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    return folder / "bin"


def checkout(folder: Path) -> Path:
    """What is checked in, without anything that was built."""
    subprocess.run(["git", "clone", "-q", str(ROOT), str(folder)], check=True)
    return folder


def size_mb(package: Path) -> dict[str, float]:
    """Bytes of what the wheel holds, and of the bytecode that Python writes beside it; MB."""
    files = [path for path in package.rglob("*") if path.is_file()]
    compiled = sum(path.stat().st_size for path in files if path.suffix == ".pyc")
    return {"files": sum(p.stat().st_size for p in files) / 1e6 - compiled / 1e6, "bytecode": compiled / 1e6}


def main() -> None:
    """Install, run, and print the table."""
    figures: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bare, programs = new_environment(folder / "bare"), new_environment(folder / "venv")
        figures["pip, dependencies alone, s"] = timed(
            [str(bare / "pip"), "install", "-q", *DEPENDENCIES], folder, str(bare)
        )
        sources, path = checkout(folder / "gelform"), str(programs)
        figures["pip install ., no compiler, s"] = timed(
            [str(programs / "pip"), "install", "-q", "."], sources, path
        )
        package = next((folder / "venv" / "lib").glob("python3*/site-packages/gelform"))
        figures |= {f"installed {k}, MB": v for k, v in size_mb(package).items()}
        presses = [str(programs / "gelform"), "simulate", "-o", "presses", "--count", "6", "--quiet"]
        figures["very first use: gelform simulate, 6 presses, s"] = timed(presses, folder, path)
        timed([str(programs / "pip"), "install", "-q", ".[plots]"], sources, path)
        figures["gelform demo, to its last picture, s"] = timed(
            [str(programs / "gelform"), "demo", "-o", "demo"], folder, path
        )
        one = [str(programs / "python"), "-c", "pass"]
        figures["a bare Python process, s"] = min(timed(one, folder, path) for _ in range(FRAMES))
    print(table(["", "figure"], [[k, f"{v:.2f}"] for k, v in figures.items()]))
    write("install", figures)


if __name__ == "__main__":
    main()
