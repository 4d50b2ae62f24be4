"""Each kernel is declared in Python as it is written in C, is used, and has a test against numpy."""

import ast
import re
from pathlib import Path

import pytest

import gelform
from gelform._native import Kernel

SOURCE = Path(gelform.__file__).parent
NATIVE = SOURCE.parents[1] / "native"
TESTS = Path(__file__).parents[1]
CTYPES = {
    "f32": "float",
    "f64": "double",
    "u8": "uint8_t",
    "u16": "uint16_t",
    "i32": "int32_t",
    "i64": "int64_t",
    "bool": "bool",
}
NOT_KERNELS = {"cpu_level", "sources_digest", "version_digest", "finite_f32"} | {
    "multigrid_plane"
}  # called by the door itself; by a test

pytestmark = pytest.mark.skipif(not NATIVE.is_dir(), reason="gelform is installed without its C sources")


def c_functions() -> dict[str, str]:
    """Exported name -> its parameters as written in C."""
    found = {}
    for path in sorted(NATIVE.rglob("*.c")):
        for returned, name, parameters in re.findall(
            r"^EXPORT ([\w ]+?[ *]+)(\w+)\(([^)]*)\)", path.read_text(), re.M
        ):
            assert name not in found, f"{name} is exported twice"
            found[name] = " ".join(parameters.split())
            if not name.endswith(("_new", "_free")):
                assert returned.strip() == "int", f"{name} returns {returned}, no status"
    return found


def declarations() -> dict[str, tuple[str, Kernel]]:
    """Exported name -> the variable that holds its kernel in Python, and the kernel."""
    found = {}
    for path in sorted(SOURCE.rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign) and ast.unparse(node.value).startswith("Kernel("):
                name, declaration = (ast.literal_eval(argument) for argument in node.value.args)
                found[name] = ast.unparse(node.targets[0]), Kernel(name, declaration)
    return found


def prototype(kernel: Kernel) -> str:
    """The parameters that a declaration promises."""
    written = []
    for p in kernel.parameters:
        if p.is_handle:
            written.append(f"struct {p.kind} *{p.name}")
        elif p.axes is None:
            written.append(f"{CTYPES[p.kind]} {p.name}")
        else:
            written.append(f"{'' if p.role == 'out' else 'const '}{CTYPES[p.kind]} *{p.name}")
    return ", ".join([*written, *(f"ptrdiff_t {size}" for size in kernel.sizes)])


C, PYTHON = c_functions(), declarations()


@pytest.mark.parametrize("name", PYTHON)
def test_declared_as_written(name):
    written = C[name].replace("restrict ", "").replace("const struct", "struct")
    assert written == prototype(PYTHON[name][1])


def test_every_exported_function_is_declared():
    assert {name for name in C if not name.endswith(("_new", "_free"))} - NOT_KERNELS == PYTHON.keys()


def test_handles_are_made_and_freed():
    kinds = {p.kind for _, kernel in PYTHON.values() for p in kernel.parameters if p.is_handle}
    assert {f"{kind}_{what}" for kind in kinds for what in ("new", "free")} <= C.keys()


def test_every_kernel_is_compared_with_numpy():
    """But those that work on a handle, which their room tests as a whole."""
    tests = "\n".join(path.read_text(encoding="utf-8") for path in sorted(TESTS.rglob("test_*.py")))
    compared = set(re.findall(r"assert_kernel_agrees\(\s*(?:\w+\.)*(\w+)", tests))
    plain = {
        variable for variable, kernel in PYTHON.values() if not any(p.is_handle for p in kernel.parameters)
    }
    assert plain <= compared


def test_no_room_but_the_door_knows_ctypes():
    for path in SOURCE.rglob("*.py"):
        if path.parent.name != "_native":
            assert not re.search(r"^\s*(import|from) ctypes", path.read_text(encoding="utf-8"), re.M), path
