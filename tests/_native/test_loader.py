"""The choice of the library, and the error if there is none."""

import platform
from pathlib import Path

import pytest

from gelform._native import ISAS, instruction_set, library
from gelform.errors import GelformError
from kernel_agreement import usable_isas


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
    anew.setattr("gelform._native.loader._FOLDER", tmp_path)
    anew.setattr("gelform._native.loader.native_folder", lambda: sources)
    with pytest.raises(GelformError, match=f"are missing .*{remedy}$"):
        library("base")
    anew.setattr("gelform._native.loader._SUFFIX", ".so")
    (tmp_path / "kernels_base.so").write_bytes(b"MZ of some other system")
    with pytest.raises(GelformError, match=f"do not load on .*{remedy}$"):
        library("base")


def test_a_processor_without_the_instructions_is_refused(anew):
    anew.setitem(ISAS, "v3", 99)
    with pytest.raises(GelformError, match=r"cannot run the kernels for 'v3'. Unset GELFORM_ISA"):
        library("v3")
