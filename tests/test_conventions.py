"""The conventions, all on one pressed sphere: axes, signs, units, dtypes.

Every error of gelform's own can be caught by one name, and none passes for a wrong argument.

The table of public names: what type checkers read is what the run gives, in an installed package too.
"""

import ast
import inspect
import json
import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import gelform
from gelform import errors

MM_PER_PX = 0.06
RADIUS_MM, CONTACT_MM = 3.0, 1.8
CENTER = (100, 60)  # column, row


@pytest.fixture(scope="module")
def sphere():
    """Depth and slopes of a ball's cap, written out from its equation."""
    y, x = np.mgrid[:140, :180].astype(float)
    u, v = (x - CENTER[0]) * MM_PER_PX, (y - CENTER[1]) * MM_PER_PX
    inside = u**2 + v**2 < CONTACT_MM**2
    height = np.sqrt(np.where(inside, RADIUS_MM**2 - u**2 - v**2, 1))
    depth = np.where(inside, height - np.sqrt(RADIUS_MM**2 - CONTACT_MM**2), 0)
    return depth, np.stack([-u / height, -v / height], axis=-1) * inside[..., None]


def test_depth_is_positive_where_pressed_and_in_mm(sphere):
    depth, gradients = sphere
    found = gelform.depth_from_gradients(gradients, mm_per_px=MM_PER_PX, zero="border")
    assert found.dtype == np.float32
    row, col = np.unravel_index(found.argmax(), found.shape)
    assert (col, row) == CENTER
    assert found.max() == pytest.approx(depth.max(), rel=1e-2)
    twice = gelform.depth_from_gradients(gradients, mm_per_px=2 * MM_PER_PX, zero="border")
    np.testing.assert_allclose(twice, 2 * found, rtol=1e-4, atol=1e-6)


def test_x_runs_to_the_right_and_y_down(sphere):
    depth, gradients = sphere
    numeric = gelform.gradients_from_depth(depth, mm_per_px=MM_PER_PX)
    assert numeric[CENTER[1], CENTER[0] + 15, 0] < 0 < numeric[CENTER[1], CENTER[0] - 15, 0]
    assert numeric[CENTER[1] + 15, CENTER[0], 1] < 0 < numeric[CENTER[1] - 15, CENTER[0], 1]
    np.testing.assert_allclose(numeric[50:70, 90:110], gradients[50:70, 90:110], atol=1e-3)


def test_normals_point_to_the_camera(sphere):
    _, gradients = sphere
    normals = gelform.normals_from_gradients(gradients)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-6)
    assert (normals[..., 2] > 0).all()
    assert normals[CENTER[1], CENTER[0] + 15, 0] > 0  # outwards, to the right
    np.testing.assert_allclose(gelform.gradients_from_normals(normals), gradients, atol=1e-5)
    np.testing.assert_allclose(gradients, -normals[..., :2] / normals[..., 2:], atol=1e-5)


def test_a_light_brightens_the_side_that_faces_it(sphere):
    _, gradients = sphere
    right = np.array([[0.5, 0, 0.8], [-0.3, 0.5, 0.8], [-0.3, -0.5, 0.8]])
    image = gelform.image_from_normals(gelform.normals_from_gradients(gradients), right)
    assert image[CENTER[1], CENTER[0] + 15, 0] > image[CENTER[1], CENTER[0] - 15, 0]
    assert image[CENTER[1] + 15, CENTER[0], 1] > image[CENTER[1] - 15, CENTER[0], 1]


def test_the_whole_path_keeps_them(calibration, sensor, press):
    """An image in, and the pressed place is where, as deep and on the side that the truth says."""
    result = gelform.Reconstructor(calibration)(press.image)
    row, col = np.unravel_index(result.depth_mm.argmax(), result.depth_mm.shape)
    assert col > sensor.shape[1] / 2 + 10
    assert row < sensor.shape[0] / 2 - 5
    np.testing.assert_allclose((col, row), press.center_px, atol=4)
    dtypes = dict.fromkeys(("depth_mm", "gradients", "confidence"), "f4") | dict.fromkeys(
        ("contact", "known"), "?"
    )
    for name, dtype in dtypes.items():
        assert getattr(result, name).dtype == np.dtype(dtype), name
    assert 0 <= result.confidence.min() <= result.confidence.max() <= 1
    assert result.mm_per_px == sensor.mm_per_px


SOURCES = sorted(Path(gelform.__file__).parent.rglob("*.py"))
FUNCTIONS = [name for name in gelform.__all__ if inspect.isfunction(getattr(gelform, name))]
TOLD_BY_NAME = {"path", "presses", "scale", "scales", "name", "folder", "simulated", "progress", "overwrite"}


def test_the_first_line_of_a_docstring_is_a_sentence():
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
    for path in SOURCES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        said = [ast.get_docstring(node) for node in ast.walk(tree) if isinstance(node, documented)]
        assert said[0], f"{path} does not say what it is"
        first_lines = [text.splitlines()[0] for text in said if text]
        assert not [line for line in first_lines if not line.endswith((".", ":", "?"))], path


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_public_function_says_what_it_takes_and_raises(name):
    """But for what its name says, or another function's docstring that it points to."""
    function = getattr(gelform, name)
    said = inspect.getdoc(function) or ""
    if re.search(r"see `\w+` for the arguments", said):
        return
    silent = [p for p in inspect.signature(function).parameters if not re.search(rf"\b{p}\b", said)]
    assert set(silent) <= TOLD_BY_NAME
    takes_arrays = any("Array" in str(p.annotation) for p in inspect.signature(function).parameters.values())
    if takes_arrays:
        assert re.search(r"\((\.\.\., )?[HWNh3]", said), "shapes"
        assert "Raises" in said or "As for `" in said, "what it refuses"


def test_one_base():
    types = [
        value for value in vars(errors).values() if isinstance(value, type) and issubclass(value, Exception)
    ]
    own = [one for one in types if one.__module__ == errors.__name__]
    assert len(own) >= 5
    assert all(issubclass(one, errors.GelformError) for one in own)
    assert not any(issubclass(one, ValueError | TypeError | OSError) for one in own)
    assert all(one.__doc__ for one in own)


def test_a_package_that_is_not_installed_names_its_extra():
    assert errors.needed("json", "none", "JSON") is json
    with pytest.raises(errors.DataError, match=r'Cubes needs the extra cube: pip install "gelform\[cube\]"'):
        errors.needed("gelform_cubes", "cube", "Cubes")


ROOT = Path(__file__).parents[1]
STUB = ast.parse(Path(gelform.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
LISTED = [node for node in STUB.body if isinstance(node, ast.ImportFrom)]


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
import gelform.sensors.cameras
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
