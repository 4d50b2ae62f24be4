"""Mutation testing: statements of a module are changed one by one, and the tests that execute them are run.

    pip install "gelform[dev,mutation]"
    python benchmarks/mutation.py anchor contact --limit 40 --seed 1     # some modules, a random sample of each
    python benchmarks/mutation.py                                        # the whole path: hours

A surviving mutant needs a test, or is equivalent: `mutants/equivalent.json` lists those with reasons. The script works
on a copy of the checkout. Tests with real data are skipped, so that the result is the same on every machine. Writes
results/mutation.json. Not part of CI.
"""

from __future__ import annotations

import argparse
import compileall
import json
import os
import shutil
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from mutants.c_code import Kernels, c_mutants
from mutants.covered import Test, executing_tests, within_budget
from mutants.forked import covering_tests, passes, source_digest
from mutants.mutant import Mutant, sample
from mutants.python_code import python_mutants

ROOT = Path(__file__).resolve().parents[1]
RESULTS = Path(__file__).parent / "results"
EQUIVALENT = Path(__file__).parent / "mutants" / "equivalent.json"
OWN_TIMEOUT_S = 240.0  # for a whole test file, on a busy machine
PATH_TESTS = ("tests/test_reconstruct_truth.py", "tests/test_reconstruct_faults.py")
RELATED = {  # test files that check a module besides its own
    "image/view/view": ("tests/image/view/test_lens.py",),
    "slopes/color_models/_shared/least_squares": tuple(
        f"tests/slopes/color_models/test_{name}.py" for name in ("lambertian", "hierarchical")
    ),
    "image/background/untouched": ("tests/slopes/confidence/test_frame_sigma.py",),
    "depth/contact": ("tests/test_contacts_measured.py",),
    "slopes/confidence/causes": ("tests/slopes/confidence/test_clipped_channels.py",),
    "slopes/color_models/forward_response": ("tests/slopes/color_models/test_older_response.py",),
    "native/depth/solvers/system.c": ("tests/depth/solvers/test_system.py", "tests/depth/test_integrate.py"),
    "native/depth/solvers/residual.c": ("tests/depth/test_integrate.py",),
    "native/slopes/gradients.c": ("tests/depth/test_integrate.py",),
    "native/finite.c": ("tests/foundations/test_checks.py", "tests/_native/test_kernel.py"),
    "native/result/metrics/center.c": ("tests/result/metrics/test_ball.py",),
    "native/simulate/ball_press.c": ("tests/simulate/gel/test_ball_press.py",),
    "native/simulate/gray_levels.c": ("tests/simulate/sensor/test_camera.py",),
    "native/simulate/irradiance.c": ("tests/simulate/test_light.py",),
    "native/simulate/membrane.c": ("tests/simulate/gel/test_membrane.py",),
    "native/simulate/mesh.c": ("tests/simulate/indenters/test_mesh.py",),
    "native/simulate/shadows.c": ("tests/simulate/test_light.py",),
    **{
        f"native/depth/solvers/multigrid/{name}.c": ("tests/depth/solvers/test_multigrid.py",)
        for name in ("coarsen", "coarsest", "conjugate", "couplings", "cycle", "grid", "islands")
    },
}
ROOMS = (
    "image/background",
    "slopes/confidence",
    "depth/sigma",
    "slopes/color_models",
    "slopes/color_models/_shared",
)
ROOMS += ("image/view", "calibration/held_out", "calibration/circles", "image/markers")
FILES = ("reconstruct", "slopes/normals", "slopes/gradients", "foundations/fill")
FILES += ("depth/anchor", "depth/integrate", "depth/stepped", "depth/contact", "image/health")


def modules() -> list[str]:
    """The modules of the path."""
    source = ROOT / "src" / "gelform"
    files = [name for name in FILES if (source / f"{name}.py").is_file()]
    rooms = [
        f"{room}/{path.stem}"
        for room in ROOMS
        for path in sorted((source / room).glob("*.py"))
        if path.stem != "__init__"
    ]
    return files + rooms


def own_tests(module: str) -> str:
    """A module's own test file; for C, the one with the same name."""
    if module == "reconstruct":
        return PATH_TESTS[0]
    room, _, name = module.removeprefix("native/").rpartition("/")
    return str(Path("tests") / room / f"test_{Path(name).stem}.py")


def candidates(module: str, wide: bool) -> list[str]:
    """Its own test file and those of the whole path; `wide`: also those of its room and of calibration."""
    room = module.removeprefix("native/").rpartition("/")[0]
    found = [own_tests(module), *RELATED.get(module, ()), *PATH_TESTS]
    if wide or module.startswith("native/"):
        found += ["tests/test_reconstruct.py"] if module == "reconstruct" else []
        found += [f"tests/test_{room}.py"]
        found += [
            str(path.relative_to(ROOT)) for path in sorted((ROOT / "tests" / room).glob("test_*.py")) if room
        ]
        found += ["tests/calibration/test_fit.py"] if module.startswith("calibration") else []
    return [test for test in dict.fromkeys(found) if (ROOT / test).exists()]


class Trial:
    """Mutants of one file in a copy of the checkout, each tested by the tests that execute its line."""

    def __init__(
        self, module: str, folder: Path, kept: Path, budget_s: float, wide: bool, by: list[str] | None
    ) -> None:
        self.module, self.folder, self.budget_s = module, folder, budget_s
        self.native = module.startswith("native/")
        self.file = folder / (module if self.native else f"src/gelform/{module}.py")
        self.source = self.file.read_text(encoding="utf-8")
        self.mutants = (c_mutants if self.native else python_mutants)(self.source)
        self.whole = None if by is None else by or [own_tests(module)]
        files = {f"src/gelform/{one}.py" for one in modules()}
        self.tests = [] if self.whole else covering_tests(folder, candidates(module, wide), files, kept)

    def judged(self, mutants: Sequence[Mutant]) -> dict[str, Any]:
        """Numbers of noticed mutants, and the list of missed ones."""
        known = {
            (entry["before"], entry["after"]): entry["because"]
            for entry in json.loads(EQUIVALENT.read_text(encoding="utf-8"))
            if entry["module"] == self.module
        }
        counts = {"noticed": 0, "equivalent": 0}
        missed = []
        for one in mutants:
            chosen = self._tests(one)
            if (one.before, one.after) in known:
                counts["equivalent"] += 1
            elif self._noticed(one, chosen):
                counts["noticed"] += 1
            else:
                missed.append(
                    {"line": one.line, "change": one.change, "before": one.before, "after": one.after}
                )
                print(
                    f"  {self.module}:{one.line} ({len(chosen)} tests)\n    - {one.before}\n    + {one.after}",
                    flush=True,
                )
        return {"mutants": len(mutants), **counts, "missed": missed}

    def _tests(self, one: Mutant) -> list[Test]:
        own = own_tests(self.module)
        if self.whole:
            return [Test(name, OWN_TIMEOUT_S / 4, frozenset()) for name in self.whole]
        if self.native:
            return within_budget(self.tests, own, self.budget_s)
        executing = executing_tests(self.tests, self.file, self.source, one.line)
        return within_budget(executing, own, self.budget_s)

    def _noticed(self, one: Mutant, tests: list[Test]) -> bool:
        if not tests:
            return False
        self.file.write_text(one.source, encoding="utf-8")
        try:
            if self.native and not kernels(self.folder).changed(self.file):
                return True  # the compiler notices
            return not passes(
                self.folder, [test.name for test in tests], 60 + 4 * sum(test.seconds for test in tests)
            )
        finally:
            self.file.write_text(self.source, encoding="utf-8")
            if self.native:
                kernels(self.folder).changed(self.file)


@cache
def kernels(folder: Path) -> Kernels:
    """The compiled kernels of the copy."""
    return Kernels(folder)


def copied(folder: Path) -> Path:
    """A copy of the checkout for the mutants."""
    ignored = shutil.ignore_patterns(".git", "results", "__pycache__", ".venv*", "build", "dist", ".*_cache")
    copy = Path(shutil.copytree(ROOT, folder / "gelform", ignore=ignored))
    compileall.compile_dir(copy / "src", quiet=1)
    return copy


def again(trial: Trial) -> dict[str, Any]:
    """The counts of the last run after another try of the missed mutants."""
    before = json.loads((RESULTS / "mutation.json").read_text())["modules"][trial.module]
    wanted = {(one["before"], one["after"]) for one in before["missed"]}
    once = {(one.before, one.after): one for one in trial.mutants}
    gone = len(before["missed"]) - sum(pair in once for pair in wanted)
    found = trial.judged([once[pair] for pair in wanted if pair in once])
    counts = {name: before[name] + found[name] for name in ("noticed", "equivalent")}
    return {**before, "mutants": before["mutants"] - gone, **counts, "missed": found["missed"]}


def record(module: str, figures: dict[str, Any]) -> None:
    """Put one module's counts into results/mutation.json."""
    child = os.fork()  # this process must not import gelform, because each forked one imports its own
    if not child:
        from report import write

        path = RESULTS / "mutation.json"
        before = json.loads(path.read_text())["modules"] if path.exists() else {}
        write("mutation", {"modules": {**before, module: figures}})
        os._exit(0)
    os.waitpid(child, 0)


def counts_table() -> str:
    """The counts of results/mutation.json by module, as Markdown."""
    from report import table

    figures = json.loads((RESULTS / "mutation.json").read_text())["modules"]
    rows = [
        [name, one["of"], one["mutants"], one["noticed"], one["equivalent"], len(one["missed"])]
        for name, one in sorted(figures.items())
    ]
    total = ["all", *(sum(row[column] for row in rows) for column in range(1, 6))]
    return table(["module", "mutants", "tried", "noticed", "equivalent", "missed"], [*rows, total])


def equivalent_list() -> str:
    """The mutants judged equivalent, by reason, as Markdown: how many of which modules."""
    modules: dict[str, list[str]] = {}
    for entry in json.loads(EQUIVALENT.read_text(encoding="utf-8")):
        modules.setdefault(entry["because"], []).append(entry["module"])
    return "\n".join(
        f"- {because} ({', '.join(sorted(set(of)))}{f': {len(of)}' if len(of) > 1 else ''})."
        for because, of in sorted(modules.items(), key=lambda item: (-len(item[1]), item[0]))
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", default=modules(), metavar="MODULE")
    parser.add_argument("--limit", type=int, default=0, help="mutants of each module; 0: all")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    parser.add_argument("--budget", type=float, default=10, help="seconds of tests of a mutant")
    parser.add_argument("--missed", action="store_true", help="only what the last run missed")
    parser.add_argument("--wide", action="store_true", help="by the tests of the whole room too")
    parser.add_argument(
        "--by",
        nargs="*",
        metavar="TEST",
        help="by these tests, its own test file if none is named, not asking what they execute: quick for few",
    )
    parser.add_argument("--keep", type=Path, help="folder for what later runs can use again")
    parser.add_argument("--table", action="store_true", help="print the counts so far, and try nothing")
    asked = parser.parse_args()
    if asked.table:
        print(counts_table(), equivalent_list(), sep="\n\n")
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = copied(Path(temporary))
        kept = asked.keep or Path(temporary) / "kept"
        made = kept / f"made-{source_digest(folder)}"
        made.mkdir(parents=True, exist_ok=True)
        os.environ |= {
            "GELFORM_DATA": "absent",
            "GELFORM_MADE": str(made),
            "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
        }
        for module in asked.modules:
            shutil.rmtree((folder / "src" / "gelform" / module).parent / "__pycache__", ignore_errors=True)
            trial = Trial(module, folder, kept, asked.budget, asked.wide, asked.by)
            if trial.whole and not passes(folder, trial.whole, OWN_TIMEOUT_S):
                print(f"{module}: {' '.join(trial.whole)}: does not pass as it is", flush=True)
                continue
            if asked.missed:
                figures = again(trial)
            else:
                mutants = sample(trial.mutants, asked.limit, f"{asked.seed} {module}")
                figures = {"of": len(trial.mutants), "seed": asked.seed, **trial.judged(mutants)}
            print(
                f"{module}: {figures['mutants']} of {figures['of']} mutants, {figures['noticed']} noticed, "
                f"{figures['equivalent']} equivalent, {len(figures['missed'])} missed",
                flush=True,
            )
            record(module, figures)


if __name__ == "__main__":
    main()
