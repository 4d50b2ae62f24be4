"""A library made from other C sources than those beside it is refused, before anything in it is called."""

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
from gelform._native.sources import digest_of_library, digest_of_sources, native_folder

pytestmark = pytest.mark.skipif(native_folder() is None, reason="gelform is installed without its C sources")
A_KERNEL = "import numpy; from gelform.gradients import fill_unknown; fill_unknown(numpy.ones((9, 9, 1)), numpy.eye(9) > 0)"


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
    source = checkout / "native/gradients/fill.c"
    source.write_text(source.read_text().replace("ptrdiff_t h", "int32_t more, ptrdiff_t h", 1))
    ran = called_in(checkout)
    assert ran.returncode == 1
    assert "made from other C sources than those in" in ran.stderr
    assert "python hatch_build.py" in ran.stderr


def test_without_sources_beside_it_a_library_is_taken_as_it_is(checkout):
    """As an installed package has it."""
    (checkout / "native/more.c").write_text("")
    (checkout / "hatch_build.py").unlink()
    assert called_in(checkout).returncode == 0


def test_a_library_that_does_not_say_has_no_digest():
    """Any that is not ours, as those were that are older than the question."""
    assert digest_of_library(ctypes.CDLL(np.random.mtrand.__file__)) is None
