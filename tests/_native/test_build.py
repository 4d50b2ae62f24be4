"""`hatch_build.py`: what it asks of the system that compiles, and what it says where that is not there."""

import importlib.util
import platform
import sys

import pytest

from gelform._native.sources import native_folder

pytest.importorskip("hatchling", reason="builds nothing without it")
pytestmark = pytest.mark.skipif(native_folder() is None, reason="gelform is installed without its C sources")


@pytest.fixture(scope="module")
def build():
    spec = importlib.util.spec_from_file_location("hatch_build", native_folder().parent / "hatch_build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def hook(build, tmp_path, monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    return build.KernelHook(str(tmp_path), {}, None, None, str(tmp_path), "wheel")


def test_zig_is_asked_for_here_and_not_beside_a_compiler(build, hook, monkeypatch):
    assert hook.dependencies() == [build.ZIG]
    monkeypatch.setenv("CC", "cc")
    assert hook.dependencies() == []


@pytest.mark.parametrize(
    ("system", "machine"), [("freebsd14", "amd64"), ("linux", "sparc64"), ("sunos5", "i86pc")]
)
def test_a_system_without_zig_is_a_sentence(hook, monkeypatch, system, machine):
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(platform, "machine", lambda: machine)
    with pytest.raises(SystemExit, match=f"no package for {system} {machine}: set CC to a C compiler"):
        hook.dependencies()
    monkeypatch.setenv("CC", "cc")
    assert hook.dependencies() == []


def test_a_compiler_that_is_not_there_is_a_sentence(build, monkeypatch, tmp_path):
    monkeypatch.setenv("CC", "no-such-compiler -O1")
    with pytest.raises(SystemExit, match='No compiler "no-such-compiler" on PATH: install it, or unset CC'):
        build.compile_kernels(tmp_path)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setenv("GELFORM_TARGET", "x86_64-windows-gnu")
    with pytest.raises(SystemExit, match="unset CC"):
        build.compile_kernels(tmp_path)
