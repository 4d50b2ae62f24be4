"""`.ci/wheel_contents.py`: a wheel that is not what its name says is found."""

import base64
import hashlib
import importlib.util
import sys
import zipfile
from pathlib import Path

import pytest

from gelform._native import loader

CHECKER = Path(__file__).parents[1] / ".ci/wheel_contents.py"
pytestmark = [
    pytest.mark.skipif(not CHECKER.exists(), reason="the source distribution has no .ci"),
    pytest.mark.skipif(sys.platform != "linux", reason="wraps the libraries of Linux on x86-64"),
    pytest.mark.skipif(not (Path(loader.__file__).parent / "kernels_v3.so").exists(), reason="of x86-64"),
]
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
    libraries = Path(loader.__file__).parent.glob("kernels_*.so")
    files = {f"gelform/_native/{path.name}": path.read_bytes() for path in libraries}
    for name in checker.MUST_HOLD:
        place = f"gelform-1.dist-info/{name}" if name.startswith("licenses") else name
        files[place] = b"text"
    files["gelform-1.dist-info/WHEEL"] = f"Root-Is-Purelib: false\nTag: py3-none-{says or tag}\n".encode()
    files |= dict.fromkeys(add, b"text")
    files = {name: data for name, data in files.items() if name not in leave_out}
    rows = [
        f"{name},sha256={base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b'=').decode()},{len(data)}"
        for name, data in files.items()
    ]
    files["gelform-1.dist-info/RECORD"] = "\n".join([*rows, "gelform-1.dist-info/RECORD,,"]).encode()
    path = folder / f"gelform-1-py3-none-{tag}.whl"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return path


def test_a_right_wheel_has_no_problems(tmp_path, checker):
    path = wheel(tmp_path, checker)
    assert checker.problems_of(path) == []
    assert "x86_64" in checker.description_of(path)


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
        (
            {"add": ["tests/depth/test_integrate.py"]},
            "tests/depth/test_integrate.py does not belong in a wheel",
        ),
        ({"add": ["gelform/left.o"]}, "gelform/left.o does not belong in a wheel"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, checker, changed, problem):
    assert any(problem in said for said in checker.problems_of(wheel(tmp_path, checker, **changed)))


def test_bytes_that_record_does_not_have_are_found(tmp_path, checker):
    path = wheel(tmp_path, checker)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("gelform/added.py", b"1")
    assert any("gelform/added.py" in said for said in checker.problems_of(path))


def test_a_library_of_another_system_is_no_library(checker):
    with pytest.raises(ValueError, match="Expected an ELF, Mach-O or PE file"):
        checker.library_from_bytes(b"\x7fOLF" + bytes(60))
