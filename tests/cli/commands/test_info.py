"""gelform info --system: the facts of the machine for a bug report.

gelform info: the description of each kind of file, and the missing parts of a folder.
"""

import re
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelform import __version__
from gelform._native import instruction_set
from gelform.calibration_file import load_calibration
from gelform.cli.commands import info
from gelform.cli.commands.info import lines_of, system_facts
from gelform.exchange.exporters.press_folder import save_moving_press
from gelform.sensors import cameras
from gelform.sensors.files import read_image
from gelform.sensors.mcap import McapRecording
from gelform.sensors.playback import RecordingFacts
from gelform.simulate import Coin
from made.sources import frames, video_file

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
    monkeypatch.setattr(info, "requires", lambda _: DECLARED)
    said = system_facts()
    old = sys.version_info < (3, 11)
    assert set(said["packages"]) == ({"numpy", "tomli"} if old else {"numpy"})
    assert said["packages"]["numpy"] == np.__version__
    assert said["extras"]["first"] == "missing: never-there"
    assert said["extras"]["second"] == f"numpy {np.__version__}"
    assert ("third" in said["extras"]) is not old
    assert "dev" not in said["extras"]


def test_cameras_are_named_without_their_serials(monkeypatch):
    mini = cameras.Camera("GelSight Mini", "/dev/video0", "2BKRDPE1", "0c45:636d", None, "gelsight-mini")
    monkeypatch.setattr(cameras, "cameras_there", lambda: [mini])
    assert system_facts()["cameras"] == ["GelSight Mini (0c45:636d, gelsight-mini)"]


def test_kernels_that_cannot_be_loaded_are_said(monkeypatch):
    monkeypatch.setattr("gelform._native.instruction_set", lambda: "v9")
    assert "GELFORM_ISA" in system_facts()["kernels"]


def test_all_distributions_that_share_cv2_are_named(monkeypatch):
    there = {"opencv-python": "4.10.0", "opencv-python-headless": "5.0.0"}
    monkeypatch.setattr(info, "_version", there.get)
    said = system_facts()["opencv"]
    assert said.startswith(
        "opencv-python 4.10.0, opencv-python-headless 5.0.0: they overwrite each other's cv2"
    )
    del there["opencv-python"]
    assert system_facts()["opencv"] == "opencv-python-headless 5.0.0"
    there.clear()
    assert system_facts()["opencv"] == "none that pip knows"


def test_a_calibration(run, run_json, calibration_file):
    said = run_json("info", calibration_file)
    assert (said["kind"], said["sensor_name"], said["color_model"]) == ("calibration", "small", "polynomial")
    assert said["training_presses"] == len(load_calibration(calibration_file).training_digests)
    lines = dict(line.split("  ", 1) for line in run("info", calibration_file)[1].splitlines())
    said = {label.strip(): text.strip() for label, text in lines.items()}
    assert said["images"].startswith("120x160 px (height x width), 0.1268 mm per pixel, uncertainty unknown")
    assert said["made from"] == "10 presses"
    assert "normals" in said["held out"]
    assert "\N{DEGREE SIGN}" in said["held out"]
    sigma = load_calibration(calibration_file).slope_sigma
    assert said["slope noise"].startswith(f"{sigma.rest:.2g} mm/mm at rest")
    assert said["slope noise"].endswith(
        f"at most {sigma.full_confidence_sigma:.2g} mm/mm in 95 % of a contact"
    )
    assert max(len(text) for text in said.values()) < 140


def test_a_calibration_of_the_first_version(works):
    file = Path(__file__).parents[2] / "data" / "calibration-version-1.npz"
    assert "64x80 px" in works("info", file)[0]


def test_a_result_and_its_image(run_json, works, calibration_file, press_folder, tmp_path):
    image, file = press_folder / "images" / "0001.png", tmp_path / "0001.npz"
    (row,) = run_json("reconstruct", image, "-c", calibration_file, "-o", tmp_path)["results"]
    said = run_json("info", file)
    assert (said["kind"], said["size_px"]) == ("result", [120, 160])
    assert said["depth_mm"][1] == round(row["peak_mm"], 4)
    assert run_json("info", image)["size_px"] == [120, 160]
    whole = run_json("info", tmp_path)
    assert (whole["kind"], whole["results"]) == ("folder of results", 1)
    assert "missing" not in whole
    out = works("info", file)[0]
    assert " mm, 0 at rest" in out
    assert "100 % of the pixels" in out
    assert re.search(r"roughness +Sa [\d.]+ um, .* form removed: quadratic, S-filter 0\.38 mm", out)
    assert re.search(r"contact 1 +[\d.]+ mm², [\d.]+ mm³, axes [\d.]+ x [\d.]+ mm, [\d.]+ mm deep at", out)


def test_what_is_unknown_is_said():
    facts = {
        "kind": "result", "size_px": [2, 4], "mm_per_px": None, "mm_per_px_sigma": None, "depth_px": [0.0, 2.5],
        "at_least": True, "contact_px": 3, "known_px": 4, "zero": "mean", "solver": "dct", "curl_rms": 0.01,
        "findings": ["It is dark."], "calibration": "0",
        "contacts": [{"area_px": 3, "area_mm2": None, "deepest_px": (1, 0), "cut_by_border": True}],
        "markers": {"in_words": "2 of 3 seen"},
    }  # fmt: skip
    said = lines_of(facts)
    assert ("depth", "0.000 to at least 2.500 px, 0 at rest, zero by: mean") in said
    assert ("warning", "It is dark.") in said
    assert ("markers", "2 of 3 seen") in said
    assert ("known", "50 % of the pixels; the others are filled") in said
    assert any("scale unknown" in text for _, text in said)
    assert ("contact 1", "3 px, deepest at (1, 0), cut by the image's border") in said
    assert ("contacts", "2 smaller ones more (--json gives all)") in lines_of(
        {**facts, "contacts": 10 * facts["contacts"]}
    )


def test_other_kinds_are_listed():
    said = lines_of({"kind": "video", "size_px": (3, 4), "balls_mm": {"6": 5}, "missing": ["a", "b"]})
    assert said == [
        ("kind", "video"), ("size", "3x4 px (height x width)"), ("balls mm", "6: 5"), ("missing", "a"), ("missing", "b"),
    ]  # fmt: skip


def test_a_folder_and_what_it_lacks(run, run_json, press_folder, tmp_path):
    said = run_json("info", press_folder)
    assert (said["presses"], said["balls_mm"], said["labelled"]) == (10, {"6": 5, "9": 5}, 10)
    assert "nothing" in run("info", press_folder)[1]
    lacks = {"background.png": "gel at rest", "presses.csv": "ball_diameter_mm", "sensor.toml": "mm_per_px"}
    for gone, text in lacks.items():
        copy = shutil.copytree(press_folder, tmp_path / gone)
        (copy / gone).unlink()
        (missing,) = run_json("info", copy)["missing"]
        assert text in missing
    copy = shutil.copytree(press_folder, tmp_path / "damaged")
    (copy / "images" / "0004.png").write_bytes(b"x")
    assert "0004.png" in run_json("info", copy)["missing"][0]


def test_frames_of_one_press_count_once(run_json, press_folder, tmp_path):
    copy = shutil.copytree(press_folder, tmp_path / "again")
    rows = (copy / "presses.csv").read_text().splitlines()
    for k in range(3):
        image = read_image(copy / "images" / f"000{k}.png")
        cv2.imwrite(str(copy / "images" / f"900{k}.png"), np.minimum(image, 254)[..., ::-1] + 1)
    again = [row.replace("images/0", "images/9") for row in rows[1:4]]
    (copy / "presses.csv").write_text("\n".join([*rows, *again]))
    said = run_json("info", copy)
    assert (said["images"], said["presses"]) == (13, 10)


def test_a_video_and_what_it_lacks(run, run_json, press_folder, tmp_path):
    path = video_file(tmp_path / "presses.avi", [read_image(press_folder / "background.png")] * 10)
    said = run_json("info", path)
    assert (said["kind"], said["size_px"], said["frames"]) == ("video", [120, 160], 10)
    assert said["duration_s"] == pytest.approx(0.4)
    assert [text for text in said["missing"] if "--ball-diameter-mm" in text]
    assert [text for text in said["missing"] if "--mm-per-px" in text]
    (tmp_path / "sensor.toml").write_text('name = "s"\nmm_per_px = 0.1\n')
    assert len(run_json("info", path)["missing"]) == 1


def test_the_frames_of_a_data_set_are_described_as_a_film(run_json, works, h5py, tmp_path, images):
    with h5py.File(tmp_path / "demos.h5", "w") as file:
        file["a/gel"] = file["b/gel"] = np.stack(images)
    said = run_json("info", tmp_path / "demos.h5")
    assert said == {
        "kind": "HDF5 file",
        "frames": ["a/gel (one of uint8 4x64x80x3)", "b/gel (one of uint8 4x64x80x3)"],
    }
    said = run_json("info", tmp_path / "demos.h5", "--dataset", "*/gel")
    assert (said["frames"], said["size_px"], said["frame_rate_hz"], said["duration_s"]) == (
        8,
        [64, 80],
        25,
        8 / 25,
    )
    assert len(said["missing"]) == 2
    assert "64x80 px" in works("info", tmp_path / "demos.h5", "--dataset", "a/gel")[0]


@pytest.mark.slow
def test_what_simulate_writes_is_described(run, run_json, works, sensor, tmp_path, press_folder):
    pytest.importorskip("h5py")
    moving = tmp_path / "moving"
    save_moving_press(moving, sensor, Coin(), ["hdf5"], 0.3, 0)
    said = run_json("info", moving / "moving.h5")
    assert said["kind"] == "HDF5 file"
    assert said["frames"] == ["data/demo_0/obs/gel (one of uint8 36x132x176x3)"]
    said = run_json("info", moving / "motion.csv")
    assert said == {"kind": "table", "columns": ["index", "depth_mm", "x_mm", "y_mm", "turn_deg"], "rows": 36}
    assert "[mm per px]" in works("info", press_folder / "sensor.toml")[0]
    (tmp_path / "a.obj").write_text("v 0 0 0")
    assert "recording, data set or table (.csv), got" in run("info", tmp_path / "a.obj")[2]


def test_folders_of_other_packages(run_json, press_folder, tmp_path):
    (tmp_path / "d" / "6mm").mkdir(parents=True)
    shutil.copy(press_folder / "background.png", tmp_path / "d")
    shutil.copy(press_folder / "images" / "0000.png", tmp_path / "d" / "6mm" / "gelsight.png")
    (tmp_path / "d" / "catalog.csv").write_text("experiment_reldir,diameter(mm)\n6mm,6\n")
    said = run_json("info", tmp_path / "d")
    assert said["kind"] == "gs_sdk folder"
    assert "No scale" in said["missing"][0]
    shutil.copy(press_folder / "sensor.toml", tmp_path / "d")
    assert run_json("info", tmp_path / "d")["presses"] == 1


def test_a_recording_says_its_camera_and_whether_it_was_finished(run, run_json, tmp_path):
    path = tmp_path / "r.mcap"
    recording = McapRecording(path, RecordingFacts("DIGIT", "D1", {"gain": 3.0}))
    for frame in frames(4):
        recording.write(frame)
    recording.close()
    facts = run_json("info", path)
    assert [facts[key] for key in ("kind", "camera", "serial", "frames")] == ["recording", "DIGIT", "D1", 4]
    assert facts["finished"] == "yes"
    path.write_bytes(path.read_bytes()[:-20])
    assert "no: its recorder was killed, or it was copied in part" in run("info", path)[1]


def test_a_folder_as_people_have_it_gets_its_lines(run, run_json, press_folder, tmp_path):
    (tmp_path / "5mm").mkdir()
    shutil.copy(press_folder / "images" / "0000.png", tmp_path / "5mm" / "0.png")
    shutil.copy(press_folder / "background.png", tmp_path / "frame0.png")
    said = run_json("info", tmp_path)
    assert said["presses.csv"] == ["image,ball_diameter_mm", "5mm/0.png,5"]
    assert f"--background {tmp_path / 'frame0.png'}" in said["missing"][0]
    out = run("info", tmp_path)[1]
    assert [line.split()[-1] for line in out.splitlines() if line.startswith("presses.csv")] == said[
        "presses.csv"
    ]


def test_the_output_of_a_batch_is_no_press_folder(run_json, works, calibration_file, press_folder, tmp_path):
    """It was told to need presses.csv."""
    works("batch", press_folder / "images", "-c", calibration_file, "-o", tmp_path / "out")
    said = run_json("info", tmp_path / "out")
    assert said == {"kind": "output of gelform batch", "check": f"gelform verify {tmp_path / 'out'}"} | said
    assert "missing" not in said
