"""Do the tests notice? Each statement of a module is changed in turn, and its tests are run: a survivor needs a test.

    pip install "gelform[dev]"
    python benchmarks/mutation.py anchor contact --limit 60       # some modules, some mutants of each, spread evenly
    python benchmarks/mutation.py                                 # the whole path: hours

Works on a copy of the checkout; Cosmic Ray makes the mutants. Writes results/mutation.json: counts by module, and the
survivors with their lines. Not part of CI.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from report import RESULTS, write

ROOT = Path(__file__).resolve().parents[1]
TIMEOUT_S = 60
# Each module with the quick tests that have to notice: those of its own and those of the path around it.
MODULES: dict[str, tuple[str, ...]] = {
    "anchor": ("tests/test_anchor.py", "tests/test_reconstruct_truth.py"),
    "contact": ("tests/test_contact.py",),
    "reconstruct": ("tests/test_reconstruct_truth.py", "tests/test_reconstruct_faults.py"),
    "depth": ("tests/test_depth.py",),
    "normals": ("tests/test_normals.py",),
    "background/untouched": ("tests/background/test_untouched.py", "tests/test_reconstruct_truth.py"),
    "background/check": ("tests/background/test_check.py",),
    "background/exposure": ("tests/background/test_exposure.py",),
    "confidence/frame_sigma": ("tests/confidence/test_frame_sigma.py", "tests/test_reconstruct_truth.py"),
    "health/levels": ("tests/health",),
    "health/torn": ("tests/health",),
    "health/frame_health": ("tests/health", "tests/test_reconstruct_faults.py"),
    "health/depth_limit": ("tests/health/test_depth_limit.py",),
}


def cosmic_ray(*arguments: str, folder: Path) -> str:
    """What a command of Cosmic Ray says; its failure ends the run."""
    environment = {**os.environ, "PYTHONPATH": f"{folder / 'src'}:{folder / 'benchmarks'}:{folder / 'tests'}"}
    done = subprocess.run(
        [sys.executable, "-m", "cosmic_ray.cli", *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise SystemExit(f"cosmic-ray {' '.join(arguments)}: {done.stderr[-2000:] or done.stdout[-2000:]}")
    return done.stdout


def mutants_of(module: str, limit: int, folder: Path) -> list[dict[str, Any]]:
    """Each mutant that was tried, with the place and whether the tests noticed."""
    tests = " ".join(MODULES[module])
    command = f"{sys.executable} -m pytest -x -q -p no:cacheprovider {tests}"
    (folder / "mutation.toml").write_text(
        f'[cosmic-ray]\nmodule-path = "src/gelform/{module}.py"\ntimeout = {TIMEOUT_S}\n'
        f'excluded-modules = []\ntest-command = "{command}"\n[cosmic-ray.distributor]\nname = "local"\n'
    )
    session = folder / "mutation.sqlite"
    session.unlink(missing_ok=True)
    cosmic_ray("init", "mutation.toml", session.name, folder=folder)
    _keep(session, limit)
    cosmic_ray("exec", "mutation.toml", session.name, folder=folder)
    return [
        _mutant(*json.loads(line)) for line in cosmic_ray("dump", session.name, folder=folder).splitlines()
    ]


def _keep(session: Path, limit: int) -> None:
    """Leave `limit` mutants in a session, evenly over the module."""
    import sqlite3

    with sqlite3.connect(session) as database:
        jobs = [
            job for (job,) in database.execute("select job_id from mutation_specs order by start_pos_row")
        ]
        kept = (
            {jobs[k * len(jobs) // limit] for k in range(limit)} if limit and limit < len(jobs) else set(jobs)
        )
        for table in ("mutation_specs", "work_items"):
            for job in set(jobs) - kept:
                database.execute(f"delete from {table} where job_id = ?", (job,))


def _mutant(item: dict[str, Any], result: dict[str, Any] | None) -> dict[str, Any]:
    mutation = item["mutations"][0]
    noticed = result is not None and (
        result["test_outcome"] == "killed" or result["worker_outcome"] != "normal"
    )
    return {
        "line": mutation["start_pos"][0],
        "change": mutation["operator_name"].removeprefix("core/"),
        "noticed": noticed,
        "diff": "" if noticed or result is None else result["diff"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", default=list(MODULES), metavar="MODULE")
    parser.add_argument("--limit", type=int, default=0, help="mutants of each module; 0: all")
    asked = parser.parse_args()
    before = RESULTS / "mutation.json"
    modules = json.loads(before.read_text())["modules"] if before.exists() else {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "gelform"
        shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(".git", "results", "__pycache__"))
        for module in asked.modules:
            mutants = mutants_of(module, asked.limit, folder)
            missed = [mutant for mutant in mutants if not mutant["noticed"]]
            print(f"{module}: {len(mutants)} mutants, {len(missed)} not noticed")
            for mutant in missed:
                print(f"  line {mutant['line']}: {mutant['change']}\n{mutant['diff']}")
            modules[module] = {
                "mutants": len(mutants),
                "noticed": len(mutants) - len(missed),
                "missed": missed,
            }
            write("mutation", {"modules": modules})


if __name__ == "__main__":
    main()
