"""Who may import whom (ARCHITECTURE.md), what the inner rooms may touch, how long files and folders may be."""

import ast
import re
import sys
from functools import cache
from pathlib import Path

import gelform

SOURCE = Path(gelform.__file__).parent
TESTS = Path(__file__).parent
ARCHITECTURE = TESTS.parent / "ARCHITECTURE.md"
LEVELS = [
    {"errors", "_native", "foundations"},
    {"gradients", "metrics", "view", "frames"},
    {"color_models", "solvers", "markers", "background", "zero"},
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
    {"sensors", "calibrations", "plots", "importers", "exporters", "torch", "starters"},
    {"calibration", "design", "streams"},
    {"batch", "live", "robots"},
    {"cli"},
]
SHELLS = {"__main__"}  # what starts the command line
LEVEL = {name: level for level, names in enumerate([*LEVELS, SHELLS]) for name in names}
INNER = 4  # the last level that neither reads, prints nor draws
MODULES = sorted(path for path in SOURCE.rglob("*.py") if path != SOURCE / "__init__.py")
# Whose same-level neighbors they may use, said in ARCHITECTURE.md.
NEIGHBORS = {
    ("_native", "errors"),
    ("foundations", "_native"),
    ("foundations", "errors"),
    ("color_models", "solvers"),
    ("calibration_file", "confidence"),
    ("confidence", "health"),  # what a lost block is
    ("reconstruction", "contact"),
    ("reconstruction", "normals"),
    ("starters", "sensors"),  # the table of makes
    ("calibrations", "sensors"),  # which unit a camera or a recording is
    ("design", "calibration"),
    ("batch", "robots"),  # LeRobot's levels
}
INNER_LIBRARIES = {"numpy", "scipy", "cv2", "gelform", "lazy_loader"}
EXTRAS = {"mlp_training.py": {"torch"}}  # imported where it trains, an extra
READERS = {"calibration_file", "reconstruction", "foundations", "_native"}
MAX_LINES, MAX_FILES = 450, 15
# What is tested through what it serves: all solvers against one truth, all forms of output.
TESTED_TOGETHER = {
    "batch/outputs/frame_files.py": "batch/outputs/test_writers.py",
    "foundations/findings.py": "background/test_check.py",
    "solvers/sparse.py": "solvers/test_seam.py",
    "solvers/curl_gated.py": "solvers/test_robust.py",
}
PUBLIC = {
    alias.name: f"gelform.{node.module}"
    for node in ast.parse((SOURCE / "__init__.pyi").read_text(encoding="utf-8")).body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}


def room(path: Path) -> str:
    """The top-level module or folder that a file belongs to."""
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def name_of(path: Path) -> str:
    """The module's name, a package's for its `__init__`."""
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


NAMES = {name_of(path) for path in MODULES}


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imports(path: Path) -> frozenset[str]:
    """Every module that a file imports, inside functions and through package inits too."""
    found = set()
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: write imports from gelform, not from ."
            found |= {_imported(node.module or "", alias.name) for alias in node.names}
    return frozenset(found)


def _imported(module: str, name: str) -> str:
    """The module that `from module import name` brings in: a module of that name, or the one that holds it."""
    if f"{module}.{name}" in NAMES:
        return f"{module}.{name}"
    return PUBLIC.get(name, module) if module == "gelform" else module


def own(path: Path) -> set[str]:
    """Which of gelform's modules a file imports; `gelform` alone is its version."""
    return {module for module in imports(path) if module.startswith("gelform.")}


def test_imports_are_seen_however_they_are_written(tmp_path):
    code = "from gelform import depth, read_image\nimport gelform.view\nfrom gelform.simulate import Ball"
    (tmp_path / "a.py").write_text(f"def f():\n    {code.replace(chr(10), chr(10) + '    ')}\n")
    wanted = {"gelform.depth", "gelform.sensors.files", "gelform.view", "gelform.simulate"}
    assert imports(tmp_path / "a.py") == wanted


def test_every_module_has_a_level_and_every_level_its_rooms():
    assert {room(path) for path in MODULES} == LEVEL.keys()


def test_the_document_has_the_same_levels():
    listed = re.findall(r"^(\d) (\w+(?: \w+)*)$", ARCHITECTURE.read_text(encoding="utf-8"), re.M)
    assert [set(names.split()) for _, names in listed] == LEVELS
    assert [int(level) for level, _ in listed] == list(range(len(LEVELS)))


def test_imports_go_down():
    upwards = [
        f"{path.relative_to(SOURCE)} (level {LEVEL[here]}) imports {module} (level {LEVEL[there]})"
        for path in MODULES
        for module in own(path)
        if (here := room(path)) != (there := module.split(".")[1])
        and LEVEL[there] >= LEVEL[here]
        and (here, there) not in NEIGHBORS
    ]
    assert not upwards


def test_every_exception_is_used():
    used = {(room(path), module.split(".")[1]) for path in MODULES for module in own(path)}
    assert used >= NEIGHBORS


def test_inner_rooms_only_compute():
    for path in (path for path in MODULES if LEVEL[room(path)] <= INNER):
        foreign = {m.split(".")[0] for m in imports(path)} - INNER_LIBRARIES - EXTRAS.get(path.name, set())
        assert foreign <= sys.stdlib_module_names - {"logging"}, f"{path} imports {foreign}"
        calls = {
            node.func.id
            for node in ast.walk(parsed(path))
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        }
        refused = {"print"} if room(path) in READERS else {"print", "open"}
        assert not calls & refused, f"{path} calls {calls & refused}"


def test_no_cycles_among_modules():
    graph = {name_of(path): own(path) for path in MODULES}
    done: set[str] = set()

    def visit(name: str, above: tuple[str, ...]) -> None:
        assert name not in above, " -> ".join((*above, name))
        if name in done:
            return
        for other in graph.get(name, ()):
            visit(other, (*above, name))
        done.add(name)

    for name in graph:
        visit(name, ())


def test_files_stay_short():
    lines = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in MODULES}
    assert not {str(path.relative_to(SOURCE)): count for path, count in lines.items() if count > MAX_LINES}


def test_folders_stay_small():
    folders = {path.parent for path in MODULES}
    crowded = {str(f.relative_to(SOURCE)): n for f in folders if (n := len(list(f.glob("*.py")))) > MAX_FILES}
    assert not crowded


def test_every_module_is_tested_in_the_folder_of_its_name():
    """By a test file of its own, or one of its room that imports it; `_private` ones without the underscore."""
    missing = []
    for path in MODULES:
        module = path.relative_to(SOURCE)
        folder = TESTS / module.parent.as_posix().replace("torch", "pytorch")  # tests/ is on the path
        files = [folder / f"test_{module.stem.lstrip('_')}.py", TESTS / TESTED_TOGETHER.get(str(module), "-")]
        of_room = any(name_of(path) in imports(file) for file in folder.glob("test_*.py"))
        if path.stem not in ("__init__", "__main__") and not (of_room or any(map(Path.exists, files))):
            missing.append(module.as_posix())
    assert not missing


def test_no_rooms_that_say_nothing():
    assert not {"utils", "core", "base", "common", "helpers"} & {path.stem for path in MODULES}


def test_every_test_file_says_what_it_is_about():
    assert not [path.name for path in TESTS.rglob("test_*.py") if not ast.get_docstring(parsed(path))]
