"""The tests that execute each line; a mutant is run only against those."""

from __future__ import annotations

import ast
import sys
import threading
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

Lines = set[tuple[str, int]]  # (file, line)


@dataclass(frozen=True)
class Test:
    """A passing test: its name, seconds, and the lines that it and its fixtures execute."""

    name: str
    seconds: float
    lines: frozenset[tuple[str, int]]


class Coverage:
    """A pytest plugin that records the executed lines of some files, by test.

    Lines of a shared fixture belong to every test that uses the fixture.
    """

    def __init__(self, files: set[str]) -> None:
        self.files = files
        self.tests: list[dict[str, Any]] = []
        self._now: Lines = set()
        self._of_fixture: dict[str, Lines] = defaultdict(set)
        self._seconds: dict[str, float] = defaultdict(float)
        self._failed: set[str] = set()

    def start(self) -> None:
        """Trace this thread and the threads that it starts."""
        threading.settrace(self._trace)
        sys.settrace(self._trace)

    def _trace(self, frame: Any, event: str, argument: Any) -> Any:
        file = frame.f_code.co_filename
        if file not in self.files or frame.f_code.co_name == "<module>":
            return None

        def line(frame: Any, event: str, argument: Any) -> Any:
            self._now.add((file, frame.f_lineno))
            return line

        return line(frame, event, argument)

    @pytest.hookimpl(hookwrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Any:
        outer, self._now = self._now, set()
        start = time.perf_counter()
        yield
        if fixturedef.scope == "session":  # made by the first run that needs it, and kept for all others
            self._seconds[request._pyfuncitem.nodeid] -= time.perf_counter() - start
        else:
            self._of_fixture[fixturedef.argname] |= self._now
        self._now = outer | self._now

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: Any) -> Any:
        self._now = set()
        yield
        for fixture in item.fixturenames:
            self._now |= self._of_fixture[fixture]
        if item.nodeid not in self._failed:
            lines = sorted(self._now)
            self.tests.append({"name": item.nodeid, "seconds": self._seconds[item.nodeid], "lines": lines})

    def pytest_runtest_logreport(self, report: Any) -> None:
        self._seconds[report.nodeid] += report.duration
        if report.outcome != "passed":
            self._failed.add(report.nodeid)


def lines_of(source: str, line: int) -> tuple[set[int], bool]:
    """Lines that are executed with the statement at `line`, and whether it is outside all functions.

    A default in a signature counts with the function's body; code outside of functions counts with the whole module.
    """
    tree = ast.parse(source)
    inside = [node for node in ast.walk(tree) if _has(node, line)]
    functions = [node for node in inside if isinstance(node, (ast.FunctionDef, ast.Lambda))]
    functions = [node for node in functions if isinstance(node, ast.FunctionDef)]
    if not functions:
        return set(), True
    function = max(functions, key=lambda node: node.lineno)
    body = function.body[0].lineno
    if line < body:
        return set(range(body, function.end_lineno + 1)), False
    statement = max(
        (node for node in inside if isinstance(node, ast.stmt)),
        key=lambda node: (node.lineno, -node.end_lineno),
    )
    inner = getattr(statement, "body", None)
    end = inner[0].lineno - 1 if isinstance(inner, list) else statement.end_lineno
    return set(range(statement.lineno, max(end, statement.lineno) + 1)), False


def _has(node: ast.AST, line: int) -> bool:
    return isinstance(node, (ast.stmt, ast.Lambda)) and node.lineno <= line <= (node.end_lineno or 0)


def executing_tests(tests: list[Test], file: Path, source: str, line: int) -> list[Test]:
    """The tests that execute the statement at a line."""
    wanted, everywhere = lines_of(source, line)
    name = str(file)
    return [
        test for test in tests if any(at == name and (everywhere or of in wanted) for at, of in test.lines)
    ]


def within_budget(tests: list[Test], own: str, budget_s: float) -> list[Test]:
    """The module's own tests first, fastest first, then the others, within the time budget."""
    chosen, seconds = [], 0.0
    for test in sorted(tests, key=lambda test: (not test.name.startswith(own), test.seconds)):
        if seconds + test.seconds <= budget_s or not chosen:
            chosen.append(test)
            seconds += test.seconds
    return chosen
