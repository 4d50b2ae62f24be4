"""What gelform takes in a fresh environment without extras: bytes of each package, CPU time of its start.

    python benchmarks/installation.py [WHEEL]       # default: built from the checkout

Start is CPU time, which other programs disturb less than time on the clock, beside that of `import numpy` in the same run.
Writes results/installation.json.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

from report import command_line, table, write

ROOT = Path(__file__).resolve().parents[1]
ROUNDS = 15
SIZES = """
import importlib.metadata, json
found = {}
for package in importlib.metadata.distributions():
    files = [file.locate() for file in package.files or [] if file.suffix != ".pyc"]
    found[package.name] = [package.version, sum(path.stat().st_size for path in files if path.exists())]
print(json.dumps({name: one for name, one in found.items() if name not in ("pip", "setuptools")}))
"""


def sizes(python: Path) -> dict[str, tuple[str, int]]:
    """Version and bytes of every installed package, without compiled bytecode."""
    found = subprocess.run([python, "-I", "-c", SIZES], check=True, capture_output=True, text=True).stdout
    return {name: (version, size) for name, (version, size) in json.loads(found).items()}


def cpu_seconds(*command: str | Path) -> float:
    """CPU time of a process and of its children."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def main() -> None:
    """Install, measure, print, record."""
    command = command_line(__doc__)
    command.add_argument("wheel", nargs="?", type=Path, help="built from the checkout by default")
    wheel = command.parse_args().wheel
    os.environ.pop("PYTHONPATH", None)  # what is measured is the installed package
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        programs = Path(folder, "bin")
        install = [programs / "pip", "install", "-q", "--no-compile", str(wheel.resolve()) if wheel else ROOT]
        subprocess.run(install, check=True, cwd=folder)
        packages = dict(sorted(sizes(programs / "python").items(), key=lambda one: -one[1][1]))
        starts: dict[str, list[str | Path]] = {
            "import numpy": [programs / "python", "-c", "import numpy"],
            "import gelform": [programs / "python", "-c", "import gelform"],
            "gelform --help": [programs / "gelform", "--help"],
        }
        times: dict[str, list[float]] = {name: [] for name in starts}
        for round_ in range(1 + ROUNDS):
            for name, command in starts.items():
                seconds = cpu_seconds(*command)
                if round_:  # the first one compiles bytecode
                    times[name].append(seconds)
    medians = {name: median(of_one) for name, of_one in times.items()}
    total = sum(size for _, size in packages.values())
    rows = [[name, version, f"{size / 1e6:.1f}"] for name, (version, size) in packages.items()]
    print(table(["package", "version", "MB"], [*rows, ["all", "", f"{total / 1e6:.0f}"]]))
    print()
    of_numpy = [[name, f"{one:.3f}", one / medians["import numpy"]] for name, one in medians.items()]
    print(table(["start", "CPU time, s", "of import numpy"], of_numpy))
    figures = {
        "packages": {name: {"version": one[0], "bytes": one[1]} for name, one in packages.items()},
        "bytes": total,
        "start_cpu_s": medians,
        "start_of_import_numpy": {name: one / medians["import numpy"] for name, one in medians.items()},
    }
    write("installation", figures)


if __name__ == "__main__":
    main()
