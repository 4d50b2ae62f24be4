"""gelform bag and gelform ros: their outputs and messages; mistakes in one line."""

import json
import shutil

import cv2
import numpy as np
import pytest

from gelform.sensors.files import read_image
from gelform.sensors.source import open_source

pytest.importorskip("rosbags", reason="the extra ros is not installed")
pytest.importorskip("mcap", reason="the extra mcap is not installed")


@pytest.fixture
def images(press_folder, tmp_path):
    """Three images of presses, as a folder."""
    others = shutil.ignore_patterns("000[3-9].png")
    return shutil.copytree(press_folder / "images", tmp_path / "frames", ignore=others)


def test_a_folder_becomes_a_bag_that_is_a_source(run_json, images, calibration_file, tmp_path):
    said = run_json("bag", images, "-c", calibration_file, "-o", tmp_path / "bag", "--name", "left", "-q")
    assert (said["frames"], said["sensor"], said["drops"]) == (3, "left", 0)
    assert said["problem"] == ""
    own = ("image_raw", "indentation", "points", "wrench")
    assert said["topics"] == [*(f"/left/{name}" for name in own), "/diagnostics"]
    assert len(list(open_source(tmp_path / "bag"))) == 3


def test_topics_are_left_out_and_missing_times_are_said(works, images, calibration_file, tmp_path):
    err = works("bag", images, "-c", calibration_file, "-o", tmp_path / "b", "--topics", "indentation")[1]
    assert "3 frames" in err
    assert "their stamps begin now" in err
    with pytest.raises(Exception, match="32FC1"):
        open_source(tmp_path / "b")


def test_info_says_what_a_bag_is(run_json, images, calibration_file, tmp_path):
    bag = tmp_path / "bag"
    run_json("bag", images, "-c", calibration_file, "-o", bag, "--name", "left", "--topics", "indentation")
    assert run_json("info", bag) == {
        "kind": "bag of ROS 2", "file": "bag.mcap", "messages": {"/left/indentation": 3},
    }  # fmt: skip
    (bag / "bag.mcap").rename(bag / "bag.db3")
    said = run_json("info", bag)
    assert said["kind"] == "bag of ROS 2"
    assert "is a bag of sqlite3. Convert it" in said["missing"][0]


def test_a_bag_without_a_usable_frame_is_no_success(run, images, calibration_file, tmp_path):
    """Depth is NaN in all of them: the calibration may be of another gel."""
    for path in images.iterdir():
        cv2.imwrite(str(path), np.ascontiguousarray(cv2.imread(str(path))[::-1, ::-1]))
    code, out, err = run("bag", images, "-c", calibration_file, "-o", tmp_path / "b", "--json")
    assert code == 1
    assert "The image is turned by 180 degrees" in json.loads(out)["problem"]
    assert "error: no frame was usable: depth is known in none of 3" in err
    assert "The image is turned by 180 degrees" in " ".join(err.split())
    assert run("bag", images, "-c", calibration_file, "-o", tmp_path / "c", "--accept-doubtful")[0] == 1


def test_a_bag_of_blue_green_red_frames_holds_rgb(run, run_json, images, calibration_file, tmp_path):
    first = sorted(images.iterdir())[0]
    image = read_image(first)
    for path in images.iterdir():
        cv2.imwrite(str(path), np.ascontiguousarray(cv2.imread(str(path))[..., ::-1]))
    given = ("bag", images, "-c", calibration_file, "-o")
    assert run_json(*given, tmp_path / "a", "--bgr")["tally"]["unknown"] == 0
    np.testing.assert_array_equal(next(iter(open_source(tmp_path / "a"))).image, image)
    assert "exchanged (--bgr" in " ".join(run(*given, tmp_path / "b")[2].split())


def test_what_is_missing_or_there_already_is_said(fails, images, calibration_file, tmp_path):
    given = ("-c", calibration_file, "-o", tmp_path / "bag")
    assert "No recording" in fails("bag", tmp_path / "missing.mcap", *given)
    tmp_path.joinpath("bag").mkdir()
    assert "is there already" in fails("bag", images, *given)


def test_no_router_is_one_sentence_that_says_what_to_do(fails, calibration_file):
    pytest.importorskip("zenoh", reason="the extra ros is not installed")
    said = fails("ros", "-c", calibration_file, "--router", "tcp/127.0.0.1:1")
    assert "No zenoh router answers at tcp/127.0.0.1:1. Start one" in said
    assert "address of a zenoh router" in fails("ros", "-c", calibration_file, "--router", "here")
