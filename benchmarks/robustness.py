"""Tens of thousands of bad inputs: the properties of tests/robustness with a larger budget and another seed.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/robustness.py                # 50,000 cases, 15 minutes
    python benchmarks/robustness.py --cases 200000 --seed 7

Every case must end in an error of gelform, a finding, or a right result. Anything else is printed and makes the exit
status 1. The script writes results/robustness.json after each round of some 7,000 cases, so that an interrupted run
counts too.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import secrets
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from report import write

ROOT = Path(__file__).resolve().parents[1]
CASES_IN_CI = 4_700  # about the number of cases in the test suite
ROUND = 7_000  # cases; each round has its own seed, the first one's plus its number
SUMMARY = re.compile(r"robustness: (\d+) cases: (.*)")


def run(cases: int, seed: int) -> tuple[int, dict[str, int], list[list[str]]]:
    """Number of cases, their endings, and the faults as (case, complaint)."""
    with tempfile.TemporaryDirectory() as folder:
        wrong = Path(folder) / "wrong.jsonl"
        environment = {
            **os.environ,
            "GELFORM_ROBUSTNESS_FACTOR": str(cases / CASES_IN_CI),
            "GELFORM_ROBUSTNESS_COLLECT": str(wrong),
        }
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            f"--hypothesis-seed={seed}",
        ]
        done = subprocess.run(
            [
                *command,
                "tests/robustness",
                "--ignore=tests/robustness/test_kills.py",
                "--ignore=tests/robustness/test_batches.py",
            ],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
        )
        complaints = [json.loads(line) for line in wrong.read_text().splitlines()] if wrong.exists() else []
    match = SUMMARY.search(done.stdout)
    if done.returncode or match is None:
        raise SystemExit(f"The suite itself failed:\n{done.stdout[-3000:]}{done.stderr[-1000:]}")
    ended = {name: int(count) for name, count in (one.rsplit(" ", 1) for one in match[2].split(", "))}
    return int(match[1]), ended, complaints


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=50_000)
    parser.add_argument("--seed", type=int, default=secrets.randbelow(10**6))
    asked = parser.parse_args()
    count, ended, complaints, rounds = 0, Counter[str](), [], 0
    while count < asked.cases:
        tried, how, wrong = run(min(ROUND, max(asked.cases - count, CASES_IN_CI // 2)), asked.seed + rounds)
        count, rounds, complaints = count + tried, rounds + 1, complaints + wrong
        ended.update(how)
        print(f"seed {asked.seed}: {count} cases in {rounds} rounds: {dict(ended)}", flush=True)
        for case, complaint in wrong:
            print(f"  {case}: {complaint}", flush=True)
        write(
            "robustness",
            {"seed": asked.seed, "rounds": rounds, "cases": count, "ended": ended, "wrong": complaints[:50]},
        )
    raise SystemExit(1 if complaints else 0)


if __name__ == "__main__":
    main()
