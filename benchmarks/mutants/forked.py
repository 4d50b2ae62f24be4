"""Runs of pytest in forked processes: libraries are imported once, gelform again in each."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2  # noqa: F401  imported here so that the forked processes need not
import hypothesis  # noqa: F401
import numpy  # noqa: F401
import pytest
import scipy.fft
import scipy.interpolate
import scipy.ndimage
import scipy.optimize
import scipy.sparse.linalg  # noqa: F401

from mutants.covered import Coverage, Test

PASSED = 0


def passes(folder: Path, tests: Sequence[str], timeout_s: float) -> bool:
    """Whether tests of a checkout pass; the first failure ends the run."""
    return _in_process(lambda: _pytest(folder, tests, ["-x"], []), folder, timeout_s) == PASSED


def covering_tests(folder: Path, tests: Sequence[str], files: set[str], kept: Path) -> list[Test]:
    """The passing tests of a checkout, with the lines of `files` that each executes.

    The result of a test file is kept in a folder for later runs, as long as neither it nor the package changes.
    """
    found: list[Test] = []
    for test in tests:
        written = kept / f"{source_digest(folder)}-{_digest([folder / test])}.json"
        if not written.exists():
            _trace(folder, test, files, written)
        found += [
            Test(
                one["name"],
                one["seconds"],
                frozenset((str(folder / file), line) for file, line in one["lines"]),
            )
            for one in json.loads(written.read_text())
        ]
    return found


def _trace(folder: Path, test: str, files: set[str], written: Path) -> None:
    """Write the lines that the tests of one file execute, and make its shared fixtures."""

    def run() -> int:
        coverage = Coverage({str(folder / file) for file in files})
        coverage.start()
        _pytest(folder, [test], [], [coverage])
        sys.settrace(None)
        for one in coverage.tests:
            one["lines"] = [(str(Path(file).relative_to(folder)), line) for file, line in one["lines"]]
        written.write_text(json.dumps(coverage.tests))
        return PASSED

    if _in_process(run, folder, 1200) != PASSED:
        raise SystemExit(f"{test} did not run: {(folder / 'output.txt').read_text()[-2000:]}")


def source_digest(folder: Path) -> str:
    """Digest of the package and of the tests' shared code."""
    return _digest([*sorted((folder / "src").rglob("*.py")), folder / "tests" / "conftest.py"])


def _digest(files: Sequence[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode() + file.read_bytes())
    return digest.hexdigest()[:20]


def _pytest(folder: Path, tests: Sequence[str], options: list[str], plugins: list[Any]) -> int:
    sys.path[:0] = [str(folder / part) for part in ("src", "tests", "benchmarks")]
    sys.dont_write_bytecode = True  # a mutant's bytecode must not remain
    _share_what_is_made_once(Path(os.environ["GELFORM_MADE"]))
    quick = ["-q", "--assert=plain", "--tb=line", "-p", "no:cacheprovider", "-p", "_hypothesis_pytestplugin"]
    base = [*quick, f"--basetemp={folder / 'temporary'}"]
    return int(pytest.main([*base, *options, *tests], plugins=plugins))


def _share_what_is_made_once(kept: Path) -> None:
    """Fixtures that take seconds are made by the first run, with unchanged code; the other runs read them."""
    import made_once

    kept.mkdir(exist_ok=True)
    make_anew = made_once.MadeOnce.__call__

    def shared(self: Any, name: str, make: Callable[[Path], Any]) -> Any:
        path = kept / f"{name}.pickle"
        if not path.exists():
            made = make_anew(made_once.MadeOnce(kept), name, make)
            path.write_bytes(pickle.dumps(made))
        return pickle.loads(path.read_bytes())

    made_once.MadeOnce.__call__ = shared


def _in_process(run: Callable[[], int], folder: Path, timeout_s: float) -> int:
    """The exit status of a function in a forked process; a timeout counts as a failure."""
    child = os.fork()
    if not child:
        os.setsid()
        os.chdir(folder)
        output = os.open(folder / "output.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1)
        os.dup2(output, 2)
        status = 70
        try:
            status = run()
        finally:
            os._exit(status)
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return -1
