"""Which numbers of the sources somebody chose, and a loader that changes one of them."""

from __future__ import annotations

import ast
import hashlib
import importlib.abc
import importlib.machinery
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
PACKAGE, NATIVE = ROOT / "src" / "gelform", ROOT / "native"
# Rooms whose numbers are no part of an estimate.
APART = {"cli", "live", "batch", "robots", "exchange", "foundations", "simulate", "_native"}
PLAIN = {0, 1, 2, 3, 4, 8, 16, 90, 100, 180, 255, 256, 360, 0.5, 0.25, 1024}
IN_C = re.compile(
    r"(?<![\w.])(\d+\.\d*(?:[eE][-+]?\d+)?|\.\d+(?:[eE][-+]?\d+)?|\d+[eE][-+]?\d+|\d+)[fFuUlL]*(?![\w.])"
)


@dataclass(frozen=True)
class Number:
    """A named constant of a source file, or the numbers without a name on one line."""

    path: str  # from the package; native/... in C
    name: str  # "" without one
    literals: tuple[tuple[int, int], ...]  # line and column of each chosen number in it
    value: str  # as written: of a name its value, else the line
    says: str  # the comment beside it
    lines: frozenset[int]  # of the statement

    @property
    def in_c(self) -> bool:
        """Whether a kernel has it."""
        return self.path.startswith("native/")

    @property
    def module(self) -> str:
        """The module that has it."""
        return "gelform." + self.path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")

    @property
    def room(self) -> str:
        """The first folder of its path."""
        parts = self.path.split("/")
        return "/".join(parts[:2]) if parts[0] == "native" else parts[0]

    @property
    def key(self) -> str:
        """What a recorded trial is found by; a line that moves keeps it."""
        return f"{self.path} | {self.name or self.value}"


def is_chosen(value: Any) -> bool:
    """Whether a literal is a number that somebody chose: no plain count, no power of ten."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or abs(value) in PLAIN:
        return False
    power = np.log10(abs(value))
    return bool(abs(power - round(power)) > 1e-12)


def numbers_of(path: Path) -> Iterator[Number]:
    """The named constants of a Python file that hold chosen numbers, and its lines with other ones."""
    source = path.read_text(encoding="utf-8")
    tree, lines, relative = ast.parse(source), source.splitlines(), str(path.relative_to(PACKAGE))
    skipped = {
        id(sub) for node in ast.walk(tree) if isinstance(node, ast.Subscript) for sub in ast.walk(node.slice)
    }
    inline: dict[int, list[ast.Constant]] = {}
    for node in tree.body:
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        if isinstance(target, ast.Tuple) and target.elts:
            names = [one.id for one in target.elts if isinstance(one, ast.Name)]
        else:
            names = [target.id] if isinstance(target, ast.Name) else []
        found = sorted(
            (
                sub
                for sub in ast.walk(node)
                if isinstance(sub, ast.Constant) and id(sub) not in skipped and is_chosen(sub.value)
            ),
            key=lambda sub: (sub.lineno, sub.col_offset),
        )
        if found and names and all(name.lstrip("_").isupper() for name in names):
            value = re.sub(r"\s+", " ", ast.unparse(node.value))  # type: ignore[attr-defined]
            places = tuple((s.lineno, s.col_offset) for s in found)
            span = frozenset(range(node.lineno, (node.end_lineno or node.lineno) + 1))
            yield Number(relative, ", ".join(names), places, value, _comment(lines, node), span)
        else:
            for sub in found:
                inline.setdefault(sub.lineno, []).append(sub)
    for at, found in sorted(inline.items()):
        code, _, says = lines[at - 1].strip().partition("  # ")
        places = tuple((s.lineno, s.col_offset) for s in found)
        yield Number(relative, "", places, code, says, frozenset({at}))


def _comment(lines: list[str], node: ast.AST) -> str:
    """The comment beside a statement, or the lines of it above."""
    beside = lines[node.end_lineno - 1].partition("  # ")[2]  # type: ignore[attr-defined]
    above, at = [], node.lineno - 2  # type: ignore[attr-defined]
    while at >= 0 and lines[at].startswith("# "):
        above.append(lines[at][2:])
        at -= 1
    return " ".join([*reversed(above), *([beside] if beside else [])])


def numbers_of_c(path: Path) -> Iterator[Number]:
    """The lines of a C file with chosen numbers."""
    lines = path.read_text(encoding="utf-8").splitlines()
    for at, code in enumerate(_blank(r"/\*.*?\*/|//[^\n]*", "\n".join(lines)).splitlines(), 1):
        found = [
            one for one in IN_C.finditer(_blank(r'\[[^\]]*\]|"[^"]*"', code)) if is_chosen(float(one[1]))
        ]
        if found:
            says = lines[at - 1].partition("//")[2].strip()
            places = tuple((at, one.start(1)) for one in found)
            relative = str(path.relative_to(ROOT))
            yield Number(relative, "", places, code.strip(), says, frozenset({at}))


def _blank(pattern: str, text: str) -> str:
    """The text with spaces where it matches; what else is in it keeps its place."""
    return re.sub(pattern, lambda found: re.sub(r"[^\n]", " ", found[0]), text, flags=re.S)


def changed_c(number: Number, factor: float) -> str:
    """The C file of a number, with the number multiplied by a factor."""
    lines = (ROOT / number.path).read_text(encoding="utf-8").splitlines()
    for at, column in sorted(number.literals, reverse=True):
        line = lines[at - 1]
        found = IN_C.match(line, column)
        assert found is not None
        text, whole = found[1], found[1].isdecimal()
        changed = _times(int(text) if whole else float(text), factor)
        lines[at - 1] = line[:column] + repr(changed) + line[column + len(text) :]
    return "\n".join(lines) + "\n"


def _times(value: float, factor: float) -> float:
    """A number times a factor; a whole number becomes another whole one."""
    changed = value * factor
    if isinstance(value, int):
        whole = round(changed)
        return whole + ((factor > 1) - (factor < 1) if whole == value else 0)
    return changed


def all_numbers() -> list[Number]:
    """Those of the estimators, Python first."""
    of_python = [
        number
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.relative_to(PACKAGE).parts[0] not in APART
        for number in numbers_of(path)
    ]
    of_c = [
        number
        for path in sorted(NATIVE.rglob("*.[ch]"))
        if path.relative_to(NATIVE).parts[0] not in APART
        for number in numbers_of_c(path)
    ]
    return of_python + of_c


def hash_of_sources() -> str:
    """Of the text of all Python and C files."""
    found = hashlib.sha256()
    for path in sorted([*PACKAGE.rglob("*.py"), *NATIVE.rglob("*.[ch]")]):
        found.update(path.read_bytes())
    return found.hexdigest()


@cache
def _sources() -> dict[str, list[str]]:
    return {
        str(path.relative_to(PACKAGE)): path.read_text(encoding="utf-8").splitlines()
        for path in PACKAGE.rglob("*.py")
    }


@cache
def uses_of(name: str) -> frozenset[tuple[str, int]]:
    """Lines in functions that use a constant, or another constant that follows from it."""
    found, word = set(), re.compile(rf"\b{name}\b")
    for path, lines in _sources().items():
        for at, line in enumerate(lines, 1):
            if not word.search(line.partition("  # ")[0]):
                continue
            if line[:1].isspace():
                found.add((path, at))
            elif (other := re.match(r"([A-Z][A-Z0-9_]+)\b.*=", line)) and other[1] != name:
                found |= uses_of(other[1])
    return frozenset(found)


def is_reached(number: Number, lines: Iterable[tuple[str, int]]) -> bool:
    """Whether a run that executed these lines used the number."""
    ran = set(lines)
    if not number.name:
        return any((number.path, at) in ran for at in number.lines)
    return any(not uses_of(name).isdisjoint(ran) for name in number.name.split(", "))


class Changed(importlib.abc.MetaPathFinder):
    """Imports one module with its number multiplied by a factor."""

    def __init__(self, number: Number, factor: float) -> None:
        self._number, self._factor = number, factor

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        """The module's spec, with a loader that changes the number; None for all other modules."""
        if name != self._number.module:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path)
        assert spec is not None
        spec.loader = _Loader(name, str(spec.origin), self._number, self._factor)
        return spec


class _Loader(importlib.machinery.SourceFileLoader):
    def __init__(self, name: str, path: str, number: Number, factor: float) -> None:
        super().__init__(name, path)
        self._number, self._factor = number, factor

    def get_code(self, fullname: str) -> Any:
        tree = ast.parse(Path(self.path).read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            place = getattr(node, "lineno", 0), getattr(node, "col_offset", 0)
            if isinstance(node, ast.Constant) and place in self._number.literals:
                node.value = _times(node.value, self._factor)  # type: ignore[arg-type]
        return compile(tree, self.path, "exec")
