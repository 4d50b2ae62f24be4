"""`.ci/release`: what it refuses, and what it leaves where a step fails. All of it takes minutes and a network.

`.ci/wheel_contents.py`: a wheel that is not what its name says is found. Every extra has a use (`extra_uses.py`), and
without its packages the use ends with a sentence that names the extra.
"""

import base64
import hashlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from extra_uses import EXTRA_OF, USES, prepared
from gelform._native import kernel

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib


ROOT = Path(__file__).parents[1]
RELEASE, CHECKER = ROOT / ".ci/release", ROOT / ".ci/wheel_contents.py"
RELEASES = pytest.mark.skipif(
    sys.platform == "win32" or not shutil.which("git") or not RELEASE.exists(),
    reason="needs bash and git, and .ci, which the source distribution lacks",
)
OF_WHEELS = pytest.mark.skipif(
    sys.platform != "linux"
    or not (Path(kernel.__file__).parent / "kernels_v3.so").exists()
    or not CHECKER.exists(),
    reason="wraps the libraries of Linux on x86-64, and needs .ci, which the source distribution lacks",
)


def git(clone, *words):
    return subprocess.run(["git", *words], cwd=clone, check=True, capture_output=True, text=True).stdout


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """What the script reads, checked in."""
    for who in ("AUTHOR", "COMMITTER"):
        monkeypatch.setenv(f"GIT_{who}_NAME", "nobody")
        monkeypatch.setenv(f"GIT_{who}_EMAIL", "nobody@example.org")
    for name in (".ci/release", "CITATION.cff", "src/gelform/__init__.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    news = "- News.\n" * 30_000  # more than a pipe holds
    (tmp_path / "CHANGELOG.md").write_text(f"# Changes\n\n## Unreleased\n\n{news}\n## 0.1.0\n\n- Old.\n")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-q", "-m", "All")
    return tmp_path


def released(clone, *words):
    """Exit status and last line."""
    done = subprocess.run([".ci/release", *words], cwd=clone, capture_output=True, text=True)
    return done.returncode, done.stdout.strip().splitlines()[-1]


@RELEASES
def test_what_stands_in_the_way_of_a_release_is_said(clone):
    for version in ((), ("",), ("v0.2.0",), ("0.2",), ("0.2.0.dev0",), ("0.2.0; ls",)):
        expected = f'Expected a version such as 0.1.0, got "{"".join(version)}".'
        assert released(clone, *version) == (1, expected)
    (clone / "new.txt").write_text("mine")
    expected = "Expected a clean clone: commit or remove what git status shows."
    assert released(clone, "0.2.0") == (1, expected)
    (clone / "new.txt").unlink()
    git(clone, "tag", "v0.2.0")
    assert released(clone, "0.2.0") == (1, "The tag v0.2.0 is there already: give another version.")
    (clone / "CHANGELOG.md").write_text("# Changes\n\n## Unreleased\n\n## 0.1.0\n\n- Old.\n")
    git(clone, "commit", "-q", "-a", "-m", "No news")
    expected = 'Expected notes under "## Unreleased" in CHANGELOG.md: write what changes for users.'
    assert released(clone, "0.3.0") == (1, expected)


@RELEASES
def test_a_release_that_fails_leaves_the_clone_as_it_was(clone, monkeypatch):
    """A python3 that fails stands where the build would begin, after the release is committed."""
    before = git(clone, "rev-parse", "HEAD")
    (clone / ".git/bin").mkdir()
    (clone / ".git/bin/python3").write_text("#!/bin/sh\ngit log -1 --format=%s > .git/reached\nexit 7\n")
    (clone / ".git/bin/python3").chmod(0o755)
    monkeypatch.setenv("PATH", f"{clone / '.git/bin'}:{os.environ['PATH']}")
    assert released(clone, "0.2.0") == (7, "nothing is released; the clone is as it was")
    assert (clone / ".git/reached").read_text() == "Release 0.2.0\n"
    assert git(clone, "rev-parse", "HEAD") == before
    assert git(clone, "status", "--porcelain") + git(clone, "tag") == ""


HERE = "manylinux_2_17_x86_64"


@pytest.fixture(scope="module")
def checker():
    spec = importlib.util.spec_from_file_location("wheel_contents", CHECKER)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look it up
    spec.loader.exec_module(module)
    return module


def wheel(folder, checker, tag=HERE, says=None, leave_out=(), add=()):
    """A wheel of the checkout's own libraries."""
    libraries = Path(kernel.__file__).parent.glob("kernels_*.so")
    files = {f"gelform/_native/{path.name}": path.read_bytes() for path in libraries}
    for name in checker.MUST_HOLD:
        place = f"gelform-1.dist-info/{name}" if name.startswith("licenses") else name
        files[place] = b"text"
    files["gelform-1.dist-info/WHEEL"] = f"Root-Is-Purelib: false\nTag: py3-none-{says or tag}\n".encode()
    files |= dict.fromkeys(add, b"text")
    files = {name: data for name, data in files.items() if name not in leave_out}
    rows = ["gelform-1.dist-info/RECORD,,"]
    for name, data in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
        rows.insert(-1, f"{name},sha256={digest},{len(data)}")
    files["gelform-1.dist-info/RECORD"] = "\n".join(rows).encode()
    path = folder / f"gelform-1-py3-none-{tag}.whl"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return path


@OF_WHEELS
def test_a_right_wheel_has_no_problems_and_bytes_that_record_does_not_have_are_found(tmp_path, checker):
    path = wheel(tmp_path, checker)
    assert checker.problems_of(path) == []
    assert "x86_64" in checker.description_of(path)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("gelform/added.py", b"1")
    assert any("gelform/added.py" in said for said in checker.problems_of(path))


@OF_WHEELS
@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        ({"tag": "manylinux_2_17_aarch64"}, "the tag says manylinux_2_17_aarch64"),
        ({"tag": "win_amd64"}, "kernels_base.dll"),
        ({"tag": "macosx_11_0_x86_64"}, "it is for manylinux x86_64"),
        ({"tag": "manylinux_2_1_x86_64"}, "it needs a system of"),
        ({"says": "linux_x86_64"}, "The file WHEEL says"),
        ({"leave_out": ["gelform/_native/kernels_v3.so"]}, "Expected the libraries"),
        ({"leave_out": ["gelform/calibration/starters/digit.npz"]}, "digit.npz is missing"),
        ({"leave_out": ["gelform-1.dist-info/licenses/NOTICE"]}, "NOTICE is missing"),
        ({"add": ["tests/test_a.py"]}, "tests/test_a.py does not belong in a wheel"),
        ({"add": ["gelform/left.o"]}, "gelform/left.o does not belong in a wheel"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, checker, changed, problem):
    assert any(problem in said for said in checker.problems_of(wheel(tmp_path, checker, **changed)))


@OF_WHEELS
def test_a_library_of_another_system_is_no_library(checker):
    with pytest.raises(ValueError, match="Expected an ELF, Mach-O or PE file"):
        checker.library_from_bytes(b"\x7fOLF" + bytes(60))


PYPROJECT = ROOT / "pyproject.toml"
SCRIPTS = {"docs"}  # of the checkout, which another process runs: `.ci/extras` tries them
HARMLESS = {"png"}  # without it Python's own zlib reads the same pixels
IMPORTED_AS = {"rerun-sdk": "rerun", "foxglove-sdk": "foxglove", "eclipse-zenoh": "zenoh"}
EXTRAS = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]["optional-dependencies"]


def modules_of(extra):
    """The modules that an extra brings, as they are imported."""
    packages = [re.match(r"[\w.-]+", one)[0] for one in EXTRAS[extra]]
    return {IMPORTED_AS.get(package, package.replace("-", "_")) for package in packages}


def test_every_extra_has_a_use():
    assert set(EXTRAS) - {"dev"} == {EXTRA_OF.get(use, use) for use in USES}


@pytest.mark.parametrize("use", sorted(set(USES) - SCRIPTS - HARMLESS))
def test_without_its_packages_it_is_named(use, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    prepared(tmp_path)
    extra = EXTRA_OF.get(use, use)
    missing = modules_of(extra)
    for module in [*missing, *sys.modules]:
        if module.split(".")[0] in missing:
            monkeypatch.setitem(sys.modules, module, None)
        elif module.startswith("gelform.torch"):
            monkeypatch.delitem(sys.modules, module)
    with pytest.raises((Exception, SystemExit)) as refused:
        USES[use]()
    said = str(refused.value).removeprefix("gelform: error: ").strip()
    assert "\n" not in said
    assert f"gelform[{extra}]" in said
