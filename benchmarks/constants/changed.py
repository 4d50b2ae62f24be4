"""Tuned constants of the package: found, used in these lines, and changed while their module is imported."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

SOURCE = Path(__file__).resolve().parents[2] / "src" / "gelform"
FOLDERS = (
    "calibration",
    "slopes/confidence",
    "depth/contact",
    "image/background",
    "slopes/color_models",
    "depth/sigma",
)
FILES = ("depth/anchor.py", "depth/stepped.py", "image/health.py")
OTHER = (
    "calibration/presses",
    "calibration/geometry",
    "calibration/report/page",
    "calibration/report/content",
    "calibration/library",
    "calibration/design",
)
NOT_TUNED = ("BYTES", "VERSION", "WORDS", "DIGEST", "COLUMNS", "NAMED")
Line = tuple[str, int]


@dataclass(frozen=True)
class Constant:
    """A module-level number: where it stands and what it is."""

    path: str  # below src/gelform
    name: str
    value: float
    start: int  # of the value's text in its line
    end: int
    line: int

    @property
    def label(self) -> str:
        """File and name."""
        return f"{self.path} {self.name}"

    def changed(self, factor: float) -> tuple[float, str]:
        """The value times a factor, an integer staying one, and the module's text with it."""
        value: float = self.value * factor
        if isinstance(self.value, int):
            rounded = int(value)
            value = rounded if rounded != self.value else self.value + (1 if factor > 1 else -1)
        lines = (SOURCE / self.path).read_text(encoding="utf-8").splitlines(keepends=True)
        text = lines[self.line - 1]
        lines[self.line - 1] = text[: self.start] + repr(value) + text[self.end :]
        return value, "".join(lines)


def constants() -> list[Constant]:
    """The tuned constants; no limit of bytes, no format version, no measure of a chart."""
    return [
        constant
        for path in sorted(SOURCE.rglob("*.py"))
        if (name := str(path.relative_to(SOURCE))) in FILES
        or name.startswith(tuple(f"{f}/" for f in FOLDERS))
        if not name.startswith(OTHER)
        for constant in _of_module(path, name)
        if not any(word in constant.name for word in NOT_TUNED)
    ]


def _of_module(path: Path, name: str) -> Iterator[Constant]:
    for statement in ast.parse(path.read_text(encoding="utf-8")).body:
        if not isinstance(statement, ast.Assign) or not isinstance(
            statement.targets[0], (ast.Name, ast.Tuple)
        ):
            continue
        target, node = statement.targets[0], statement.value
        pairs = (
            zip(target.elts, node.elts)
            if isinstance(target, ast.Tuple) and isinstance(node, ast.Tuple)
            else [(target, node)]
        )
        for of, value in pairs:
            number = _number(value)
            if isinstance(of, ast.Name) and number is not None and value.lineno == value.end_lineno:
                yield Constant(name, of.id, number, value.col_offset, value.end_col_offset or 0, value.lineno)


def _number(node: ast.expr) -> float | None:
    try:
        value = eval(compile(ast.Expression(node), "", "eval"), {"__builtins__": {}})  # literals alone pass
    except (NameError, TypeError, AttributeError):
        return None
    return value if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def lines_with(wanted: list[Constant]) -> dict[Line, set[str]]:
    """Lines of functions that read a constant, by its own name or as it is imported elsewhere."""
    by_module = {(_module(one.path), one.name): one.label for one in wanted}
    found: dict[Line, set[str]] = {}
    for path in SOURCE.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        module = _module(str(path.relative_to(SOURCE)))
        names = {name: label for (of, name), label in by_module.items() if of == module}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    if (node.module, alias.name) in by_module:
                        names[alias.asname or alias.name] = by_module[node.module, alias.name]
        for node in ast.walk(tree):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in names:
                found.setdefault((str(path), node.lineno), set()).add(names[node.id])
    return found


def _module(path: str) -> str:
    return "gelform." + path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


class Executed:
    """Notes which constants are read while it traces; those of a module's own statements count from its import."""

    def __init__(self, lines: dict[Line, set[str]]) -> None:
        self.lines, self.labels = lines, set[str]()
        self._files = {file for file, _ in lines}
        self._holding: dict[CodeType, bool] = {}

    def start(self) -> None:
        """Trace this thread from here on."""
        sys.settrace(self._called)

    def _called(self, frame: FrameType, event: str, of: Any) -> Any:
        code = frame.f_code
        if code not in self._holding:
            spans = (
                {line for _, _, line in code.co_lines() if line} if code.co_filename in self._files else set()
            )
            self._holding[code] = any((code.co_filename, line) in self.lines for line in spans)
        if not self._holding[code]:
            return None
        return self._line

    def _line(self, frame: FrameType, event: str, of: Any) -> Any:
        self.labels |= self.lines.get((frame.f_code.co_filename, frame.f_lineno), set())
        return self._line


class _Text(SourceFileLoader):
    """Loads a module from another text than its file has."""

    def __init__(self, name: str, path: str, text: str) -> None:
        super().__init__(name, path)
        self.text = text

    def get_code(self, fullname: str) -> CodeType:
        return compile(self.text, self.path, "exec")


class ChangedModule:
    """On `sys.meta_path`: this module is imported from this text, whoever asks for it."""

    def __init__(self, path: str, text: str) -> None:
        self.path, self.name, self.text = str(SOURCE / path), _module(path), text

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """The module's, nothing for any other."""
        if fullname != self.name:
            return None
        return spec_from_file_location(fullname, self.path, loader=_Text(fullname, self.path, self.text))
