"""What each chosen number does: multiplied and divided by 1.2, one at a time, on fixed real frames and presses.

    python benchmarks/constants.py image depth     # prints a row of each: place, name, value, x 1.2, / 1.2, origin
    python benchmarks/constants.py image --inline  # numbers without a name, too

Each trial is a process of its own, which imports gelform with one number of its source changed; so what follows from the
number changes with it. Figures of frames: greatest depth, pixels of contact, findings. Figures of presses: presses used,
degrees and radius on held-out presses. "nothing" means that no figure changes in its fourth digit.
"""

from __future__ import annotations

import ast
import importlib.abc
import importlib.machinery
import multiprocessing
import os
import pickle
import re
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import scipy.fft
import scipy.linalg
import scipy.ndimage
import scipy.optimize
import scipy.sparse.linalg  # noqa: F401  # each child would load these again

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "gelform"
DATA = Path(os.environ.get("GELFORM_DATA", ROOT.parent / "shared" / "data"))
ROOMS = ("image", "slopes", "depth", "calibration")
SETS = ("mini-ball", "digit-ball", "gelslim-dots", "mini-d", "homemade-even/a")
PRESSES, FRAMES, FACTOR = 13, 3, 1.2
PLAIN = {0, 1, 2, 3, 4, 8, 16, 90, 100, 180, 255, 256, 360, 0.5, 0.25, 1024}


@dataclass(frozen=True)
class Number:
    """One constant of a source file, or one number without a name."""

    path: str  # from the package
    name: str  # "" without one
    literals: tuple[tuple[int, int], ...]  # line and column of each number in it
    value: str  # as written
    says: str  # the comment beside it

    @property
    def module(self) -> str:
        """The module that has it."""
        return "gelform." + self.path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def is_chosen(value: Any) -> bool:
    """Whether a literal is a number that somebody chose: no plain count, no power of ten."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or abs(value) in PLAIN:
        return False
    power = np.log10(abs(value))
    return bool(abs(power - round(power)) > 1e-12)


def numbers_of(path: Path, inline: bool = False) -> Iterator[Number]:
    """The named constants of a file, and with `inline` its other numbers."""
    source = path.read_text(encoding="utf-8")
    tree, lines, relative = ast.parse(source), source.splitlines(), str(path.relative_to(PACKAGE))
    skipped = {
        id(sub) for node in ast.walk(tree) if isinstance(node, ast.Subscript) for sub in ast.walk(node.slice)
    }
    for node in tree.body:
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        named = isinstance(target, ast.Name) and target.id.lstrip("_").isupper() and len(target.id) > 1
        found = [
            sub
            for sub in ast.walk(node)
            if isinstance(sub, ast.Constant) and id(sub) not in skipped and is_chosen(sub.value)
        ]
        if found and named:
            above = lines[node.lineno - 2].strip()
            beside = lines[node.end_lineno - 1].partition("  # ")[2]
            says = beside or (above.lstrip("# ") if above.startswith("#") else "")
            value = re.sub(r"\s+", " ", ast.unparse(node.value))
            yield Number(relative, target.id, tuple((s.lineno, s.col_offset) for s in found), value, says)
        elif inline:
            for sub in found:
                yield Number(
                    relative,
                    "",
                    ((sub.lineno, sub.col_offset),),
                    str(sub.value),
                    lines[sub.lineno - 1].strip(),
                )


class Changed(importlib.abc.MetaPathFinder):
    """Imports one module with its number multiplied by a factor."""

    def __init__(self, number: Number, factor: float) -> None:
        self._number, self._factor = number, factor

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> Any:
        """The module's spec, with a loader that changes the number; None for all other modules."""
        if name != self._number.module:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path)
        spec.loader = _Loader(name, spec.origin)
        spec.loader.number, spec.loader.factor = self._number, self._factor
        return spec


class _Loader(importlib.machinery.SourceFileLoader):
    number: Number
    factor: float

    def get_code(self, name: str) -> Any:
        tree = ast.parse(Path(self.path).read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            place = getattr(node, "lineno", 0), getattr(node, "col_offset", 0)
            if isinstance(node, ast.Constant) and place in self.number.literals:
                changed = node.value * self.factor
                if isinstance(node.value, int):
                    changed = round(changed)
                    changed += (self.factor > 1) - (self.factor < 1) if changed == node.value else 0
                node.value = changed
        return compile(tree, self.path, "exec")


def pressed(name: str) -> Any:
    """Presses of a set, evenly chosen, without circles of people."""
    import gelform
    from presses import unlabeled

    presses = gelform.read_presses(DATA / name)
    chosen = np.unique(np.linspace(0, len(presses.presses) - 1, PRESSES).round().astype(int))
    return unlabeled(presses, chosen.tolist())


def of_presses(name: str) -> dict[str, Any]:
    """Figures of a calibration by few presses."""
    import gelform

    report = gelform.calibrate(pressed(name)).report
    held = report.held_out
    return {
        "used": sum(press.accepted for press in report.presses),
        "degrees": held.get("normal_free_deg"),
        "radius": held.get("radius_percent"),
    }


def of_frames(name: str, calibration: Any) -> dict[str, Any]:
    """Figures of some frames, in the order of the presses; the first is far from the center in most sets."""
    import gelform

    reconstruct, figures = gelform.Reconstructor(calibration), {}
    for k, press in enumerate(pressed(name).presses[1 :: PRESSES // FRAMES]):
        result = reconstruct(press.image)
        figures[f"depth {k}"] = float(result.depth_mm.max())
        figures[f"contact {k}"] = int(result.contact.sum())
        figures[f"sigma {k}"] = float(np.median(result.depth_sigma_mm))
        figures[f"findings {k}"] = ", ".join(sorted(finding.name for finding in result.health))
    return figures


def figures_of(room: str, calibrations: dict[str, bytes]) -> dict[str, Any]:
    """All figures of a room, by set and name; the name of an error in their place where there is one."""
    found: dict[str, Any] = {}
    for name in calibrations:
        try:
            if room == "calibration":
                figures = of_presses(name)
            else:
                figures = of_frames(name, pickle.loads(calibrations[name]))
        except Exception as problem:  # a trial may make the work impossible, which is its figure
            figures = {"error": f"{type(problem).__name__}: {problem}"[:80]}
        found |= {f"{name} {key}": value for key, value in figures.items()}
    return found


def _child(number: Number | None, factor: float, work: Any, given: tuple[Any, ...], out: str) -> None:
    if number is not None:
        sys.meta_path.insert(0, Changed(number, factor))
    Path(out).write_bytes(pickle.dumps(work(*given)))


def in_child(work: Any, *given: Any, number: Number | None = None, factor: float = 1.0) -> Any:
    """What a function gives in a fresh process, which imports gelform itself."""
    with tempfile.NamedTemporaryFile() as file:
        child = multiprocessing.get_context("fork").Process(
            target=_child, args=(number, factor, work, given, file.name)
        )
        child.start()
        child.join()
        content = Path(file.name).read_bytes()
    return pickle.loads(content) if content else {"all": "no import"}


def calibrations_of(names: tuple[str, ...]) -> dict[str, bytes]:
    """Calibrations by the few presses of each set, pickled."""
    import gelform

    return {name: pickle.dumps(gelform.calibrate(pressed(name))) for name in names}


def change(before: dict[str, Any], after: dict[str, Any]) -> str:
    """What changed, in words: the largest of each kind of figure."""
    changes: dict[str, float] = {}
    said = [
        f"{key.split()[0]}: {value}"
        for key, value in after.items()
        if key.endswith("error") and before.get(key) != value
    ]
    for key, old in before.items():
        new, kind = after.get(key), key.split()[1]
        if isinstance(old, str) and new is not None and new != old:
            changes[kind] = changes.get(kind, 0) + 1
        elif isinstance(old, (int, float)) and isinstance(new, (int, float)):
            rest = (new - old) if kind in ("used", "degrees", "radius") else (new - old) / max(abs(old), 1e-3)
            if abs(rest) > max(abs(changes.get(kind, 0)), 1e-3):
                changes[kind] = rest
    for kind, size in changes.items():
        said.append(
            f"{kind} {size:+.2f}"
            if kind in ("used", "degrees", "radius")
            else f"{size:.0f} {kind}"
            if kind == "findings"
            else f"{kind} {100 * size:+.1f} %"
        )
    return ", ".join(said) or "nothing"


def main() -> None:
    """Run the rooms that were asked for and print their rows."""
    from report import command_line, parts_asked

    command = command_line(__doc__)
    command.add_argument("--inline", action="store_true", help="numbers without a name, too")
    command.add_argument("--only", default="", help="those whose path or name matches")
    command.add_argument("--cache", type=Path, help="keep the calibrations there")
    asked = parts_asked(command, ROOMS)
    if asked.cache and asked.cache.is_file():
        calibrations = pickle.loads(asked.cache.read_bytes())
    else:
        calibrations = in_child(calibrations_of, SETS)
        if asked.cache:
            asked.cache.write_bytes(pickle.dumps(calibrations))
    for room in asked.parts:
        print(f"## {room}", flush=True)
        before = in_child(figures_of, room, calibrations)
        print(before, flush=True)
        for path in sorted((PACKAGE / room).rglob("*.py")):
            for number in numbers_of(path, asked.inline):
                if asked.only and not re.search(asked.only, f"{number.path} {number.name}"):
                    continue
                more, less = (
                    change(before, in_child(figures_of, room, calibrations, number=number, factor=factor))
                    for factor in (FACTOR, 1 / FACTOR)
                )
                print(
                    f"| {number.path} | {number.name or number.literals} | {number.value} | {more} | {less} | "
                    f"{number.says}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
