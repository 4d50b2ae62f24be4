"""gelform info --system: the facts of the machine for a bug report."""

import sys

import numpy as np
import pytest

from gelform import __version__
from gelform._native import instruction_set
from gelform.cli import system
from gelform.cli.system import system_facts
from gelform.sensors.cameras import camera

DECLARED = [
    "numpy>=1.26",
    "tomli>=2; python_version < '3.11'",
    "never-there>=3; extra == 'first'",
    "numpy>=1.26; extra == 'second'",
    "zarr>=3; (python_version >= '3.11') and extra == 'third'",
    "pytest>=8; extra == 'dev'",
]


def test_it_says_versions_and_the_instruction_set(run, run_json):
    said = run_json("info", "--system")
    assert (said["kind"], said["gelform"], said["kernels"]) == ("system", __version__, instruction_set())
    assert said["python"].startswith(".".join(map(str, sys.version_info[:3])))
    assert "cameras" in said
    words = [line.split() for line in run("info", "--system")[1].splitlines()]
    assert ["gelform", __version__] in words
    assert ["kernels", instruction_set()] in words


def test_requirements_are_sorted_into_packages_and_extras(monkeypatch):
    monkeypatch.setattr(system, "requires", lambda _: DECLARED)
    said = system_facts()
    old = sys.version_info < (3, 11)
    assert set(said["packages"]) == ({"numpy", "tomli"} if old else {"numpy"})
    assert said["packages"]["numpy"] == np.__version__
    assert said["extras"]["first"] == "missing: never-there"
    assert said["extras"]["second"] == f"numpy {np.__version__}"
    assert ("third" in said["extras"]) is not old
    assert "dev" not in said["extras"]


def test_cameras_are_named_without_their_serials(monkeypatch):
    mini = camera.Camera("GelSight Mini", "/dev/video0", "2BKRDPE1", "0c45:636d", None, "gelsight-mini")
    monkeypatch.setattr(camera, "cameras_there", lambda: [mini])
    assert system_facts()["cameras"] == ["GelSight Mini (0c45:636d, gelsight-mini)"]


def test_kernels_that_cannot_be_loaded_are_said(monkeypatch):
    monkeypatch.setattr("gelform._native.instruction_set", lambda: "v9")
    assert "GELFORM_ISA" in system_facts()["kernels"]


@pytest.mark.parametrize("arguments", [["info"], ["info", "--system", "presses"]])
def test_a_file_or_the_system_is_asked_for(fails, arguments):
    assert "--system" in fails(*arguments, status=2)


def test_all_distributions_that_share_cv2_are_named(monkeypatch):
    there = {"opencv-python": "4.10.0", "opencv-python-headless": "5.0.0"}
    monkeypatch.setattr(system, "_version", there.get)
    said = system_facts()["opencv"]
    assert said.startswith(
        "opencv-python 4.10.0, opencv-python-headless 5.0.0: they overwrite each other's cv2"
    )
    del there["opencv-python"]
    assert system_facts()["opencv"] == "opencv-python-headless 5.0.0"
    there.clear()
    assert system_facts()["opencv"] == "none that pip knows"
