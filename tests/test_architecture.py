"""The import levels of ARCHITECTURE.md, file sizes, and what the inner rooms may touch."""

import ast
from pathlib import Path

import pytest

import gelform

SOURCE = Path(gelform.__file__).parent
LEVELS = [
    {"errors", "checks", "_native", "progress", "pool", "resample"},
    {"gradients", "ball", "metrics", "view", "lens", "frames", "npz_files"},
    {"color_models", "solvers", "markers", "background"},
    {
        "normals",
        "depth",
        "depth_sigma",
        "anchor",
        "confidence",
        "contact",
        "health",
        "calibration_file",
        "reconstruction",
    },
    {"reconstruct", "simulate"},
    {"sensors", "plots", "importers", "exporters"},
    {"calibration", "design"},
    {"cli"},
]
LEVEL = {name: level for level, names in enumerate(LEVELS) for name in names}
MODULES = sorted(path for path in SOURCE.rglob("*.py") if path != SOURCE / "__init__.py")
# Whose same-level neighbours they may use, said in ARCHITECTURE.md.
NEIGHBOURS = {
    ("_native", "errors"),
    ("view", "lens"),
    ("metrics", "ball"),
    ("calibration_file", "confidence"),
    ("reconstruction", "normals"),
    ("depth_sigma", "depth"),
    ("design", "calibration"),
}
INNER_LIBRARIES = {"numpy", "scipy", "numba", "cv2", "gelform"}
EXTRAS = {"mlp_training.py": {"torch"}}  # imported where it trains, an extra
READERS = {"calibration_file", "reconstruction", "npz_files"}


def room(path: Path) -> str:
    """The top-level module or folder that a file belongs to."""
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def imports(path: Path) -> set[str]:
    """Every module that a file imports, inside functions too."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            found.add(node.module)
    return found


def test_every_module_has_a_level():
    assert {room(path) for path in MODULES} <= LEVEL.keys()


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_imports_go_down(path):
    here = room(path)
    for module in imports(path):
        if not module.startswith("gelform."):
            continue
        there = module.split(".")[1]
        allowed = LEVEL[there] < LEVEL[here] or there == here or (here, there) in NEIGHBOURS
        assert allowed, f"{path.name} (level {LEVEL[here]}) imports {module} (level {LEVEL[there]})"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_inner_rooms_only_compute(path):
    if LEVEL[room(path)] > 4:
        return
    foreign = {m.split(".")[0] for m in imports(path)} - INNER_LIBRARIES - EXTRAS.get(path.name, set())
    assert foreign <= set(__import__("sys").stdlib_module_names), foreign
    calls = {
        node.func.id
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert "print" not in calls
    assert "open" not in calls or room(path) in READERS


def test_no_cycles_inside_a_folder():
    graph = {
        ".".join(path.relative_to(SOURCE).with_suffix("").parts): {
            module.removeprefix("gelform.") for module in imports(path) if module.startswith("gelform.")
        }
        for path in MODULES
    }
    done: set[str] = set()

    def visit(name: str, above: tuple[str, ...]) -> None:
        assert name not in above, " -> ".join((*above, name))
        if name in done or name not in graph:
            return
        for other in graph[name]:
            if other in graph and not other.endswith("__init__"):
                visit(other, (*above, name))
        done.add(name)

    for name in graph:
        visit(name, ())


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_files_stay_short(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 400


def test_no_rooms_that_say_nothing():
    assert not {"utils", "core", "base", "common", "helpers"} & {room(path) for path in MODULES}
