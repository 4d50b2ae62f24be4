"""Every example runs unchanged, asserts something, and is short.

docs/adding-a-color-model.md, followed word for word.

The camera for LeRobot reports versions that are too old; runs with any Python and LeRobot.
"""

import importlib.util
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import gelform
from gelform.calibration.selection import candidates_for, color_model_names
from gelform.slopes import color_models

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
QUICK = ("01_photometric_stereo", "02_why_least_squares")  # calibrate nothing


def test_there_is_one_for_each_route():
    routes = (EXAMPLES[0].parents[1] / "docs" / "routes.md").read_text(encoding="utf-8")
    assert len(EXAMPLES) >= 8
    assert [path.name for path in EXAMPLES if f"../examples/{path.name}" not in routes] == []
    for path in EXAMPLES:
        assert len(path.read_text().splitlines()) <= 60, path
        assert "assert " in path.read_text(), path


@pytest.mark.parametrize(
    "path",
    [pytest.param(one, marks=() if one.stem in QUICK else pytest.mark.slow) for one in EXAMPLES],
    ids=lambda path: path.stem,
)
def test_example_runs_twice_and_after_others(path, tmp_path):
    for name in ("presses", "sessions", "depth"):  # as examples of earlier versions left them
        (tmp_path / name).mkdir()
        (tmp_path / name / "a").touch()
    for _ in range(2 if path.stem[:2] in ("07", "08") else 1):  # which wrote to one folder
        done = subprocess.run(
            [sys.executable, path], cwd=tmp_path, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stderr


ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "adding-a-color-model.md"


def blocks(language):
    """The page's code blocks in a language."""
    found = re.findall(rf"^ *```{language}\n(.*?)^ *```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    return [textwrap.dedent(block) for block in found]


@pytest.fixture
def added(tmp_path, monkeypatch):
    """The model of the page, its file written and its class listed as step 1 and 2 say."""
    code, import_line = blocks("python")
    path = re.search(r"This is `(src/gelform/\S+\.py)`", PAGE.read_text(encoding="utf-8"))[1]
    assert (ROOT / path).parent == Path(color_models.__file__).parent
    (tmp_path / Path(path).name).write_text(code)
    name = f"gelform.slopes.color_models.{Path(path).stem}"
    spec = importlib.util.spec_from_file_location(name, tmp_path / Path(path).name)
    monkeypatch.setitem(sys.modules, name, importlib.util.module_from_spec(spec))
    spec.loader.exec_module(sys.modules[name])
    listed = Path(color_models.__file__).read_text(encoding="utf-8")
    last = '    "lookup": LookupModel,\n'
    assert last in listed
    namespace = {}
    exec(import_line + listed.replace(last, f"{last}    {blocks('text')[0]}"), namespace)
    table = namespace["COLOR_MODELS"]
    (new,) = table.keys() - color_models.COLOR_MODELS.keys()
    monkeypatch.setitem(color_models.COLOR_MODELS, new, table[new])
    return new


def test_every_file_that_the_page_names_is_there():
    text = re.sub(r"\S*linear\.py", "", PAGE.read_text(encoding="utf-8"))
    named = re.findall(
        r"`(?:python -m pytest |python )?((?:src|tests|benchmarks|color_models)/[\w/.]+)", text
    )
    assert len(named) >= 5
    for path in named:
        assert (ROOT / path).exists() or (ROOT / "src" / "gelform" / path).exists(), path


@pytest.mark.slow
def test_the_model_calibrates_by_name(added, presses, tmp_path):
    assert added in color_model_names()
    calibration = gelform.calibrate(presses.subset(range(8)), color_model=added)
    assert calibration.color_model.name == added
    calibration.save(tmp_path / "cal.npz")
    again = gelform.load_calibration(tmp_path / "cal.npz")
    image = presses.presses[0].image
    np.testing.assert_array_equal(
        gelform.Reconstructor(again)(image).depth_mm, gelform.Reconstructor(calibration)(image).depth_mm
    )
    assert [one.model for one in candidates_for(added, len(presses.presses))] == [added]


INTEGRATIONS = ROOT / "integrations"
CAMERA = INTEGRATIONS / "lerobot_camera_gelform"
WITH_INTEGRATIONS = pytest.mark.skipif(
    not INTEGRATIONS.is_dir(), reason="integrations/ is not part of this distribution"
)


def module_at(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def check_versions():
    return module_at(CAMERA / "lerobot_camera_gelform/versions.py").check_versions


@WITH_INTEGRATIONS
def test_older_ones_are_named_and_new_enough_ones_pass(check_versions):
    """An older Python would get an older LeRobot."""
    for python in ((3, 10, 2), (3, 11, 7)):
        shown = r"\.".join(map(str, python))
        said = rf"Python 3\.12 or later, got {shown}: .*0\.4\.4.*python3\.12 -m venv"
        with pytest.raises(ImportError, match=said):
            check_versions(python, "0.6.1")
    for version in ("0.4.4", "0.5.0", "0.5.1.dev3"):
        with pytest.raises(ImportError, match=rf"LeRobot 0\.6 or later, got {version}.*pip install"):
            check_versions((3, 12, 1), version)
    for version in ("0.6.0", "0.6.1rc1", "0.7.2", "1.0.0"):
        check_versions((3, 12, 0), version)
    check_versions((3, 14, 0), "0.7.0")


@WITH_INTEGRATIONS
def test_importing_it_here_works_or_says_what_to_do():
    command = [sys.executable, "-c", "import lerobot_camera_gelform"]
    env = {"PYTHONPATH": str(CAMERA), "PATH": ""}
    ran = subprocess.run(command, capture_output=True, text=True, env=env)
    assert ran.returncode == 0 or "ImportError: Expected " in ran.stderr
