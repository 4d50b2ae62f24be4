"""The camera for LeRobot reports versions that are too old; runs with any Python and LeRobot."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parents[2] / "integrations/lerobot_camera_gelform"
pytestmark = pytest.mark.skipif(not HERE.is_dir(), reason="integrations/ is not part of this distribution")


@pytest.fixture(scope="module")
def check_versions():
    path = HERE / "lerobot_camera_gelform/versions.py"
    spec = importlib.util.spec_from_file_location("versions", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.check_versions


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


def test_importing_it_here_works_or_says_what_to_do():
    command = [sys.executable, "-c", "import lerobot_camera_gelform"]
    env = {"PYTHONPATH": str(HERE), "PATH": ""}
    ran = subprocess.run(command, capture_output=True, text=True, env=env)
    assert ran.returncode == 0 or "ImportError: Expected " in ran.stderr
