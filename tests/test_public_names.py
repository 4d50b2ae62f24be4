"""The table of public names: what type checkers read is what the run gives, in an installed package too."""

import ast
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import gelform

ROOT = Path(__file__).parents[1]
STUB = Path(gelform.__file__).with_suffix(".pyi")
LISTED = [
    node for node in ast.parse(STUB.read_text(encoding="utf-8")).body if isinstance(node, ast.ImportFrom)
]


def test_the_names_of_the_stub_are_those_of_the_package():
    names = [alias.name for node in LISTED for alias in node.names]
    assert len(names) == len(set(names))
    assert sorted(names) == sorted(gelform.__all__)
    assert set(names) <= set(dir(gelform))


def test_each_name_is_its_module_s_own():
    for node in LISTED:
        (alias,) = node.names
        assert alias.asname == alias.name, "type checkers take `X as X` alone for a public name"
        value = getattr(gelform, alias.name)
        assert value is getattr(import_module(f"gelform.{node.module}"), alias.name), alias.name
        assert not isinstance(value, type(sys)), f"a folder of the same name hides {alias.name}"


def test_a_name_that_is_none():
    with pytest.raises(AttributeError, match="nothing"):
        gelform.nothing  # noqa: B018


def test_importing_gelform_imports_nothing_heavy():
    code = "import sys, gelform; print(*{'numpy', 'scipy', 'cv2', 'matplotlib'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "\n"


@pytest.mark.slow
def test_importing_everything_leaves_the_process_as_it_was():
    code = """
import os, cv2, gelform
cv2.setNumThreads(3)
there = dict(os.environ)
for name in gelform.__all__:
    getattr(gelform, name)
import gelform.sensors.cameras.usb
print(cv2.getNumThreads(), dict(os.environ) == there)
"""
    ours = {name: value for name, value in os.environ.items() if not name.startswith("OPENCV")}
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=ours)
    assert ran.stdout == "3 True\n"


def test_the_stub_is_in_the_wheel_and_the_sdist():
    """The run reads it: without it an installed gelform could not be imported."""
    builders = import_module("hatchling.builders.wheel"), import_module("hatchling.builders.sdist")
    wheel, sdist = builders[0].WheelBuilder(str(ROOT)), builders[1].SdistBuilder(str(ROOT))
    packed = {file.distribution_path for file in wheel.recurse_included_files()}
    assert {"gelform/__init__.pyi", "gelform/py.typed"} <= packed
    assert "src/gelform/__init__.pyi" in {file.distribution_path for file in sdist.recurse_included_files()}
