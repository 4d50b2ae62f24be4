"""Who may import whom (ARCHITECTURE.md), what the inner rooms may touch, how long files and folders may be."""

import ast
import re
import sys
from functools import cache
from pathlib import Path

import pytest

import gelform

SOURCE = Path(gelform.__file__).parent
TESTS = Path(__file__).parent
ARCHITECTURE = TESTS.parent / "ARCHITECTURE.md"
LEVELS = [
    {"arrays", "errors"},
    {"_native"},
    {"foundations"},
    {"image"},
    {"slopes"},
    {"depth"},
    {"calibration_file", "result"},
    {"reconstruct", "simulate", "motion"},
    {"sensors"},
    {"exchange"},
    {"calibration"},
    {"sensors/streams"},  # begins with a starter, or with a calibration of the library
    {"robots", "torch"},
    {"batch", "live"},
    {"cli"},
]
SHELLS = {"__main__"}  # what starts the command line
LEVEL = {name: level for level, names in enumerate([*LEVELS, SHELLS]) for name in names}
INNER = 7  # the last level that neither reads, prints nor draws
MODULES = sorted(path for path in SOURCE.rglob("*.py") if path != SOURCE / "__init__.py")
INNER_LIBRARIES = {"numpy", "scipy", "cv2", "gelform", "lazy_loader"}
EXTRAS = {"networks.py": {"torch"}}  # imported where it trains, an extra
READERS = {"calibration_file", "result", "foundations", "_native"}
MAX_LINES, MAX_FILES = 650, 15
# What is tested beside what it serves.
TESTED_TOGETHER = {
    "arrays.py": "test_architecture.py",  # mypy tests it
    "cli/commands/calibrations.py": "cli/commands/test_exchange.py",
    "cli/commands/force.py": "cli/commands/test_calibrate.py",
    "robots/lerobot_depth.py": "robots/test_ros_messages.py",
    "simulate/presets.py": "simulate/test_press.py",
}
PUBLIC = {
    alias.name: f"gelform.{node.module}"
    for node in ast.parse((SOURCE / "__init__.pyi").read_text(encoding="utf-8")).body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}


def room_of(module: str) -> str:
    """The room with a level that a module (`gelform.sensors.files`) belongs to; the inner one of two."""
    parts = module.split(".")[1:]
    names = ["/".join(parts[:count]) for count in range(len(parts), 0, -1)]
    return next((name for name in names if name in LEVEL), parts[0])


def room(path: Path) -> str:
    """The room of a file."""
    return room_of(name_of(path))


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
    code = "from gelform import image, read_image\nimport gelform.depth\nfrom gelform.simulate import Ball"
    (tmp_path / "a.py").write_text(f"def f():\n    {code.replace(chr(10), chr(10) + '    ')}\n")
    wanted = {"gelform.image", "gelform.sensors.files", "gelform.depth", "gelform.simulate"}
    assert imports(tmp_path / "a.py") == wanted


def test_every_module_has_a_level_and_every_level_its_rooms():
    assert {room(path) for path in MODULES} == LEVEL.keys()


def test_the_document_has_the_same_levels():
    listed = re.findall(r"^(\d+) ([\w/]+(?: [\w/]+)*)$", ARCHITECTURE.read_text(encoding="utf-8"), re.M)
    assert [set(names.split()) for _, names in listed] == LEVELS
    assert [int(level) for level, _ in listed] == list(range(len(LEVELS)))


def walked() -> list[tuple[str, list[str]]]:
    """The walks of the document: a function or class of gelform, and the names in it, in their order."""
    lines = re.findall(r"^[a-z ]* +([\w.]+): ([\w >]+)$", ARCHITECTURE.read_text(encoding="utf-8"), re.M)
    return [(name, steps.split(" > ")) for name, steps in lines]


@pytest.mark.parametrize(
    ("name", "steps"), walked(), ids=lambda value: value if isinstance(value, str) else ""
)
def test_the_walks_lead_through_the_code(name, steps):
    """The function's own code has every step after the one before."""
    path = max((one for one in MODULES if f"gelform.{name}".startswith(f"{name_of(one)}.")), key=name_of)
    body: ast.AST = parsed(path)
    for part in f"gelform.{name}".removeprefix(f"{name_of(path)}.").split("."):
        body = next(node for node in body.body if getattr(node, "name", "") == part)
    calls = [node for node in ast.walk(body) if isinstance(node, ast.Call)]
    names = [(c.end_lineno, c.end_col_offset, ast.unparse(c.func).rpartition(".")[2]) for c in calls]
    names += [(node.lineno, 0, node.name) for node in ast.walk(body) if isinstance(node, ast.FunctionDef)]
    found = iter(one for *_, one in sorted(names))
    missing = [step for step in steps if step not in found]
    assert not missing, f"{name} has no {missing} in this order"


def test_the_walks_are_of_images_presses_and_live_frames():
    assert {name.split(".")[0] for name, _ in walked()} == {"reconstruct", "calibration", "sensors"}


def test_imports_go_down():
    upwards = [
        f"{path.relative_to(SOURCE)} (level {LEVEL[here]}) imports {module} (level {LEVEL[there]})"
        for path in MODULES
        for module in own(path)
        if (here := room(path)) != (there := room_of(module)) and LEVEL[there] >= LEVEL[here]
    ]
    assert not upwards


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


def circle_in(graph: dict[str, set[str]]) -> str:
    """Names that lead from one back to itself; empty where no circle is."""
    done: set[str] = set()

    def visit(name: str, above: tuple[str, ...]) -> str:
        if name in above:
            return " -> ".join((*above[above.index(name) :], name))
        found = (
            ""
            if name in done
            else next(filter(None, (visit(n, (*above, name)) for n in graph.get(name, ()))), "")
        )
        done.add(name)
        return found

    return next(filter(None, (visit(name, ()) for name in graph)), "")


def test_no_circles_among_modules():
    assert not circle_in({name_of(path): own(path) for path in MODULES})


def test_the_parts_of_a_room_import_one_way():
    """Its files, and its folders each as one."""
    circles = {}
    for folder in {path.parent for path in MODULES} - {SOURCE}:
        inside = f"gelform.{folder.relative_to(SOURCE).as_posix().replace('/', '.')}."
        graph: dict[str, set[str]] = {}
        for path in folder.rglob("*.py"):
            part = name_of(path).removeprefix(inside).split(".")[0]
            others = {m.removeprefix(inside).split(".")[0] for m in own(path) if m.startswith(inside)}
            graph[part] = graph.get(part, set()) | others - {part}
        circles[folder.relative_to(SOURCE).as_posix()] = circle_in(graph)
    assert not {name: circle for name, circle in circles.items() if circle}


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
