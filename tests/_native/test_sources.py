"""A library of other C sources or of another version, or without its end, is refused before anything in it is called."""

import ctypes
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import gelform
from gelform._native import instruction_set, library
from gelform._native.sources import (
    digest_of_library,
    digest_of_sources,
    digest_of_version,
    is_cut_off,
    native_folder,
)

pytestmark = pytest.mark.skipif(native_folder() is None, reason="gelform is installed without its C sources")
A_KERNEL = (
    "import numpy; from gelform.foundations.filters import fill_unknown;"
    " fill_unknown(numpy.ones((9, 9, 1)), numpy.eye(9) > 0)"
)


@pytest.fixture(scope="module")
def checkout(tmp_path_factory) -> Path:
    """A copy of this one, with its libraries."""
    root = tmp_path_factory.mktemp("checkout")
    package = Path(gelform.__file__).parent
    shutil.copytree(package, root / "src/gelform", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(native_folder(), root / "native")
    shutil.copy(native_folder().parent / "hatch_build.py", root)
    return root


def called_in(checkout: Path) -> subprocess.CompletedProcess[str]:
    """What a new process says that calls a kernel of a checkout."""
    environment = {**os.environ, "PYTHONPATH": str(checkout / "src")}
    command = [sys.executable, "-c", A_KERNEL]
    return subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True)


def test_the_library_in_use_is_of_these_sources():
    assert digest_of_library(library(instruction_set())) == digest_of_sources(native_folder())


def test_every_change_of_the_sources_counts(tmp_path):
    (tmp_path / "room").mkdir()
    seen = {digest_of_sources(tmp_path)}
    for name, content in (("a.c", "int a;"), ("a.c", "int b;"), ("room/b.h", ""), ("notes.md", "none")):
        (tmp_path / name).write_text(content)
        seen.add(digest_of_sources(tmp_path))
    (tmp_path / "a.c").rename(tmp_path / "room/a.c")
    assert len(seen | {digest_of_sources(tmp_path)}) == 5  # all but the one that no compiler reads


def test_a_library_left_over_from_other_sources_is_refused(checkout):
    assert called_in(checkout).returncode == 0
    source = checkout / "native/foundations/fill.c"
    source.write_text(source.read_text().replace("ptrdiff_t h", "int32_t more, ptrdiff_t h", 1))
    ran = called_in(checkout)
    assert ran.returncode == 1
    assert "made from other C sources than those in" in ran.stderr
    assert "python hatch_build.py" in ran.stderr


@pytest.fixture
def installed(checkout, tmp_path) -> Path:
    """The package alone, as a wheel installs it: no C sources, so its version must do."""
    shutil.copytree(checkout / "src", tmp_path / "src")
    return tmp_path


def said_by(run: subprocess.CompletedProcess[str]) -> str:
    """The last line of an error; no signal has ended the process."""
    assert run.returncode == 1, run.stderr
    return run.stderr.strip().splitlines()[-1]


def test_an_installed_library_is_of_its_version(installed):
    assert called_in(installed).returncode == 0
    package = installed / "src/gelform/__init__.py"
    package.write_text(package.read_text().replace(f'"{gelform.__version__}"', '"9.9.9"'))
    said = said_by(called_in(installed))
    assert "are not of gelform 9.9.9, which is half installed" in said
    assert said.endswith("pip install --force-reinstall --no-deps gelform")


@pytest.mark.parametrize("share", [0.02, 0.5, 0.999])
def test_a_library_without_its_end_is_a_sentence(installed, share):
    """Linux maps such a file, and the process would die at the first page that is missing."""
    for path in (installed / "src/gelform/_native").glob("kernels_*"):
        content = path.read_bytes()
        path.write_bytes(content[: int(len(content) * share)])
    said = said_by(called_in(installed))
    assert "The end of gelform's compiled kernels is missing" in said or "do not load on" in said
    assert said.endswith("pip install --force-reinstall --no-deps gelform")


def test_whole_libraries_and_other_files_are_not_cut_off(tmp_path):
    for path in Path(gelform.__file__).parent.glob("_native/kernels_*"):
        assert not is_cut_off(path)
    for content in (b"", b"\x7fELF\x02", b"MZ" + bytes(80)):
        (tmp_path / "x.so").write_bytes(content)
        assert not is_cut_off(tmp_path / "x.so")


def test_a_library_that_does_not_say_has_no_digest():
    """Any that is not ours, as those were that are older than the question."""
    other = ctypes.CDLL(np.random.mtrand.__file__)
    assert digest_of_library(other) is digest_of_library(other, "version") is None


def test_versions_differ_in_their_digest():
    assert digest_of_library(library("base"), "version") == digest_of_version(gelform.__version__)
    assert len({digest_of_version(one) for one in ("0.2.0", "0.2.0.dev0", "0.2.1", "")}) == 4
