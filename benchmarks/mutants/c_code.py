"""The mutants of a C file, and the kernels compiled with one of them.

Each mutant changes an operator, a comparison, a number or an index at one place. Preprocessor lines, comments, and the
checks of sizes at a kernel's entry (`WRONG_SIZE`), which no caller in Python can fail, are left out.
"""

from __future__ import annotations

import os
import re
import runpy
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

from mutants.mutant import Mutant, mutant

SWAPPED = {
    **{
        " + ": " - ",
        " - ": " + ",
        " * ": " / ",
        " / ": " * ",
        " += ": " -= ",
        " -= ": " += ",
        " *= ": " /= ",
    },
    **{" < ": " <= ", " <= ": " < ", " > ": " >= ", " >= ": " > ", " == ": " != ", " != ": " == "},
    **{" && ": " || ", " || ": " && ", "fminf(": "fmaxf(", "fmaxf(": "fminf(", "fabsf(": "("},
}
OPERATOR = re.compile("|".join(map(re.escape, SWAPPED)))
NUMBER = re.compile(r"(?<![\w.])(\d+\.\d*(?:e-?\d+)?f?|\d+)(?![\w.])")
MINUS = re.compile(r"(?<=[=(,?:] )-(?=[\w(])|(?<=\()-(?=[\w(])|(?<=return )-(?=[\w(])")
SKIPPED = re.compile(r"^\s*(#|//|/\*)|WRONG_SIZE|restrict \w+\[|static_assert|_Alignas")
FLAGS = "-std=c11 -O1 -fPIC -fvisibility=hidden -ffp-contract=off -fno-math-errno -w"


def c_mutants(source: str) -> list[Mutant]:
    """Every mutant of a file's text, in the order of its lines."""
    found = []
    lines = source.splitlines(keepends=True)
    for index, line in enumerate(lines):
        if SKIPPED.search(line):
            continue
        code = line.split("//")[0]
        for change, start, end, text in _changes(code):
            changed = "".join([*lines[:index], line[:start] + text + line[end:], *lines[index + 1 :]])
            found.append(mutant(source, changed, index + 1, change))
    return found


def _changes(code: str) -> Iterator[tuple[str, int, int, str]]:
    for match in OPERATOR.finditer(code):
        yield "Operator", match.start(), match.end(), SWAPPED[match.group()]
    for match in MINUS.finditer(code):
        yield "Sign", match.start(), match.end(), ""
    for match in NUMBER.finditer(code):
        for text in _numbers(match.group()):
            yield "Number", match.start(), match.end(), text


def _numbers(text: str) -> tuple[str, str]:
    """A number changes by 1."""
    suffix = "f" if text.endswith("f") else ""
    value = float(text.rstrip("f")) if "." in text else int(text)
    below = f"({value - 1}{suffix})" if value < 1 else f"{value - 1}{suffix}"
    return f"{value + 1}{suffix}", below


class Kernels:
    """The kernels of a checkout, one object per file, so that a mutant compiles quickly."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.objects = folder / "objects"
        self.objects.mkdir()
        self.files = sorted((folder / "native").rglob("*.c"))
        for file in self.files:
            if not self._compile(file):
                raise SystemExit(f"{file} does not compile: set CC to a C compiler.")
        self.link()

    def changed(self, file: Path) -> bool:
        """Compile what depends on a file; return whether it compiles."""
        return all(self._compile(one) for one in self._using(file)) and self.link()

    def link(self) -> bool:
        """Replace the libraries of all instruction sets by one, so that each is the mutant.

        It contains the digest of the present sources, which the package checks.
        """
        library = self.folder / "kernels.so"
        sources = runpy.run_path(str(self.folder / "src/gelform/_native/sources.py"))
        digest = sources["digest_of_sources"](self.folder / "native")
        cpu = self.folder / "native" / "cpu.c"
        self._run("-c", f"-DSOURCES_DIGEST={digest}u", "-o", str(self._object(cpu)), str(cpu))
        linked = self._run("-shared", "-o", str(library), *[str(self._object(file)) for file in self.files])
        for place in (self.folder / "src" / "gelform" / "_native").glob("kernels_*.so"):
            place.unlink()
            shutil.copy(library, place)
        return linked

    def _using(self, file: Path) -> list[Path]:
        """The files to compile when one changes: itself, or those that include it."""
        if file.suffix == ".c":
            return [file]
        including = [
            one for one in (self.folder / "native").rglob("*.[ch]") if f'{file.name}"' in one.read_text()
        ]
        return sorted({user for one in including for user in self._using(one)})

    def _object(self, file: Path) -> Path:
        return self.objects / ("_".join(file.relative_to(self.folder / "native").parts) + ".o")

    def _compile(self, file: Path) -> bool:
        return self._run("-c", "-o", str(self._object(file)), str(file))

    def _run(self, *arguments: str) -> bool:
        command = [*shlex.split(os.environ.get("CC", "cc")), *FLAGS.split(), *arguments, "-lm"]
        return not subprocess.run(command, cwd=self.folder, capture_output=True).returncode
