"""The choice of the library, and the error if there is none.

The check at the kernels' entry: arguments that do not fit a kernel's declaration never reach C.

Each kernel is declared in Python as it is written in C, is used, and has a test against numpy.
"""

import gc
import platform
import re
from pathlib import Path

import numpy as np
import pytest

import gelform
from gelform._native import ISAS, Handle, Kernel, instruction_set, is_finite, library
from gelform._native.kernel import parameters_of, sizes_of
from gelform.errors import GelformError
from kernel_agreement import declarations, usable_isas


@pytest.fixture
def anew(monkeypatch):
    """Nothing is loaded yet; what a test loads is forgotten."""
    library.cache_clear()
    instruction_set.cache_clear()
    yield monkeypatch
    monkeypatch.undo()
    library.cache_clear()
    instruction_set.cache_clear()


def test_the_best_is_chosen_unless_the_environment_chooses(anew):
    anew.delenv("GELFORM_ISA", raising=False)
    assert instruction_set() == usable_isas()[-1]
    instruction_set.cache_clear()
    anew.setenv("GELFORM_ISA", "base")
    assert instruction_set() == "base"


def test_cpu_level_agrees_with_the_system():
    """An independent witness: what Linux says of the processor."""
    try:
        flags = Path("/proc/cpuinfo").read_text()
    except OSError:
        pytest.skip("no /proc/cpuinfo here")
    if platform.machine() != "x86_64":
        assert library("base").cpu_level() == 1
        return
    words = set(flags.split())
    v3, v4 = {"avx2", "fma"}, {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"}
    assert library("base").cpu_level() == (1 if not v3 <= words else 3 if not v4 <= words else 4)


def test_an_unknown_set_is_refused(anew):
    anew.setenv("GELFORM_ISA", "v9")
    with pytest.raises(ValueError, match="one of base, v3, v4, got 'v9'"):
        library(instruction_set())


@pytest.mark.parametrize(
    ("sources", "remedy"),
    [(Path("native"), r"python hatch_build\.py"), (None, "pip install --force-reinstall --no-deps gelform")],
)
def test_a_missing_library_and_one_for_another_platform_say_what_to_do(anew, tmp_path, sources, remedy):
    anew.setattr("gelform._native.kernel._FOLDER", tmp_path)
    anew.setattr("gelform._native.kernel.native_folder", lambda: sources)
    with pytest.raises(GelformError, match=f"are missing .*{remedy}$"):
        library("base")
    anew.setattr("gelform._native.kernel._SUFFIX", ".so")
    (tmp_path / "kernels_base.so").write_bytes(b"MZ of some other system")
    with pytest.raises(GelformError, match=f"do not load on .*{remedy}$"):
        library("base")


def test_a_processor_without_the_instructions_is_refused(anew):
    anew.setitem(ISAS, "v3", 99)
    with pytest.raises(GelformError, match=r"cannot run the kernels for 'v3'. Unset GELFORM_ISA"):
        library("v3")


ZEROS = np.zeros((3, 4), np.float32)


ROW, COLUMN = ZEROS[0], ZEROS[:, 0].copy()
REFUSED = [
    ("f32[h,w] depth", [np.zeros((3, 4))], "depth as an array of float32, got float64."),
    ("f32[h,w] a, f32[w] b", [ZEROS, COLUMN], "b of shape (w), h = 3, w = 4, got (3,)."),
    ("f32[h,w,2] a", [ZEROS[..., None]], "a of shape (h, w, 2), got (3, 4, 1)."),
    ("f32[h,w] a", [ROW], "a of shape (h, w), got (4,)."),
    ("f32[...] a, f32[...,1] b", [ZEROS, COLUMN[:, None]], "b of shape (count, 1), count = 12, got (3, 1)."),
    ("f32[...,3] b", [np.zeros((), np.float32)], "b of shape (count, 3), got (1,)."),
    ("finite f32[h,w] a", [ZEROS + np.float32(np.inf)], "finite a, got NaN or infinity."),
    ("finite f64[h,w] a", [np.full((3, 4), np.nan)], "finite a, got NaN or infinity."),
    ("f32[h] a, f32 b", [ROW], "2 arguments, got 1."),
    ("solver* prepared", [None], 'Handle("solver", ...), got None.'),
]


@pytest.mark.parametrize(("declaration", "arguments", "said"), REFUSED)
def test_what_does_not_fit_a_declaration_never_reaches_c(declaration, arguments, said):
    with pytest.raises((TypeError, ValueError), match=f"^no_such_kernel: expected {re.escape(said)}$"):
        Kernel("no_such_kernel", declaration)(*arguments)


def test_parameters_are_given_in_order_or_by_name_and_each_once():
    of_range, found = Kernel("range_f32", "f32[...] values, out f32[2] range"), np.empty(2, np.float32)
    of_range(range=found, values=np.float32([3, -1, 2]))
    assert found.tolist() == [-1, 3]
    for arguments, named in (
        ((ZEROS,), {"found": found}),
        ((), {"range": found}),
        ((ZEROS, found), {"range": found}),
    ):
        with pytest.raises(TypeError, match=r"range_f32: expected .*by name, got"):
            of_range(*arguments, **named)


def test_a_handle_that_cannot_be_made_leaves_nothing_to_free():
    with pytest.raises(AttributeError, match="no_such_handle_new"):
        Handle("no_such_handle", 3)
    gc.collect()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [0, 15, 16, 30])
def test_finite_sees_every_place(bad, place, usable_isa, monkeypatch):
    kernels = library(usable_isa)
    monkeypatch.setattr("gelform._native.kernel.library", lambda _: kernels)
    values = np.full(31, 3e38, np.float32)
    assert is_finite(values)
    values[place] = bad
    assert not is_finite(values)
    assert not is_finite(np.repeat(values, 2)[::2])


DECLARATION = "finite f32[h,w,3] image, u8[h,w]? mask, out f32[...,2] slopes, grid* grid, f32 factor"


def test_a_declaration_is_read():
    image, mask, slopes, grid, factor = parameters_of(DECLARATION)
    assert (image.role, image.kind, image.axes, image.optional) == ("finite", "f32", ("h", "w", "3"), False)
    assert mask.optional
    assert slopes.axes == ("...", "2")
    assert [one.is_handle for one in (image, grid, factor)] == [False, True, False]
    assert sizes_of((image, mask, slopes, grid, factor)) == ("h", "w", "count")


@pytest.mark.parametrize("text", ["f31[h] a", "f32[h]", "f32 [h] a", "in f32[h] a", ""])
def test_what_is_no_declaration_is_refused(text):
    with pytest.raises(ValueError, match="Expected a parameter such as"):
        parameters_of(text)


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
# Called by the door itself.
NOT_KERNELS = {"cpu_level", "sources_digest", "version_digest", "finite_f32"}

MARK_DECLARATIONS = pytest.mark.skipif(
    not NATIVE.is_dir(), reason="gelform is installed without its C sources"
)


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


@MARK_DECLARATIONS
@pytest.mark.parametrize("name", PYTHON)
def test_declared_as_written(name):
    written = C[name].replace("restrict ", "").replace("const struct", "struct")
    assert written == prototype(PYTHON[name][1])


@MARK_DECLARATIONS
def test_every_exported_function_is_declared():
    assert {name for name in C if not name.endswith(("_new", "_free"))} - NOT_KERNELS == PYTHON.keys()


@MARK_DECLARATIONS
def test_every_kernel_is_compared_with_numpy():
    """But those that work on a handle, which their room tests as a whole."""
    tests = "\n".join(path.read_text(encoding="utf-8") for path in sorted(TESTS.rglob("test_*.py")))
    compared = set(re.findall(r"assert_kernel_agrees\(\s*(?:\w+\.)*(\w+)", tests))
    plain = {
        variable for variable, kernel in PYTHON.values() if not any(p.is_handle for p in kernel.parameters)
    }
    assert plain - {"_contact_mask", "PRESSED_REGIONS"} <= compared, "those are compared with their steps"


@MARK_DECLARATIONS
def test_no_room_but_the_door_knows_ctypes():
    for path in SOURCE.rglob("*.py"):
        if path.parent.name != "_native":
            assert not re.search(r"^\s*(import|from) ctypes", path.read_text(encoding="utf-8"), re.M), path
