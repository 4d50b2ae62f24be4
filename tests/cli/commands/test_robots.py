"""gelform bag and gelform ros: their outputs and messages; mistakes in one line.

gelform track: the table of poses, one surface of the keyframes, and mistakes in one line.
"""

import csv
import json
import shutil

import cv2
import numpy as np
import pytest

import gelform
from gelform.sensors.files import read_image
from gelform.sensors.source import open_source
from gelform.simulate import HeightMap, Pose, simulate_pose
from made.rigid_contacts import texture
from made.small_gel import save


@pytest.fixture
def images(press_folder, tmp_path):
    """Three images of presses, as a folder."""
    pytest.importorskip("rosbags", reason="the extra ros is not installed")
    pytest.importorskip("mcap", reason="the extra mcap is not installed")
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


STEP_MM = 0.4


@pytest.fixture(scope="module")
def slide(small, made_once):
    """A folder of images: the gel at rest, then a bar with a texture that slides to the right, one frame each."""
    return made_once("slide", lambda folder: _slid(folder, small))


def _slid(folder, sensor):
    rng = np.random.default_rng(5)
    y, x = (np.mgrid[:121, :401] - np.array([60, 200])[:, None, None]) * 0.05
    bar = HeightMap(1.5 * texture(2)(0.6 * x, 0.6 * y), 0.05)
    poses = [Pose(0.0), *(Pose(0.45, (STEP_MM * k, 0.0)) for k in range(6))]
    for k, pose in enumerate(poses):
        save(folder / f"{k:03d}.png", simulate_pose(sensor, bar, pose, rng=rng, oversample=1).image)
    return folder


def test_a_slide_becomes_a_table_and_a_surface(works, slide, calibration_file, tmp_path):
    table, surface = tmp_path / "out" / "track.csv", tmp_path / "bar.npz"
    how = ("-c", calibration_file, "-o", table, "--surface", surface, "--prior", "0.5,2", "--json")
    out, err = works("track", slide, *how)
    assert f"Wrote {table}: " in err
    said = json.loads(out)
    assert (said["frames"], said["states"]) == (7, {"lost": 1, "found": 6})
    assert said["lost_by_reason"] == {"no contact": 1}
    with table.open() as file:
        rows = list(csv.DictReader(file))
    assert [row["state"] for row in rows] == ["lost", *["found"] * 6]
    assert "no contact" in rows[0]["why"]
    assert rows[0]["x_mm"] == ""
    found = np.array([float(row["x_mm"]) for row in rows[1:]])
    np.testing.assert_allclose(found, STEP_MM * np.arange(6), atol=0.08)
    assert all(0 < float(row["sigma_x_mm"]) < 0.2 for row in rows[2:])
    assert gelform.load_result(surface).known.any()


def test_frames_of_blue_green_red_give_the_same_track(run, slide, calibration_file, tmp_path):
    (tmp_path / "bgr").mkdir()
    for k in range(3):
        frame = gelform.read_image(slide / f"{k:03d}.png")
        cv2.imwrite(str(tmp_path / "bgr" / f"{k}.png"), frame)
        cv2.imwrite(str(tmp_path / f"{k}.png"), frame[..., ::-1])
    for folder, more in ((tmp_path, ()), (tmp_path / "bgr", ("--bgr",))):
        assert run("track", folder, "-c", calibration_file, "-o", folder / "t.csv", *more)[0] == 0
    assert (tmp_path / "bgr" / "t.csv").read_text() == (tmp_path / "t.csv").read_text()


def test_frames_of_another_size_are_named_in_every_command_that_plays_them(
    fails, slide, calibration_file, tmp_path
):
    """All of them, or one in the middle of the others."""
    small = cv2.resize(cv2.imread(str(slide / "003.png")), (80, 60))
    for name, numbers in (("all", range(2)), ("one", [1])):
        folder = tmp_path / name
        folder.mkdir()
        for k in range(3):
            shutil.copy(slide / f"{k:03d}.png", folder / f"{k}.png")
        for k in numbers:
            cv2.imwrite(str(folder / f"{k}.png"), small)
        for command, output in (("track", "t.csv"), ("bag", "bag")):
            said = fails(command, folder, "-c", calibration_file, "-o", tmp_path / f"{name} {output}")
            assert f"{folder}: Frame {numbers[0]}: Expected frames of 120x160 px (height x width)" in said
            assert "got 60x80" in said


def test_an_object_that_is_mostly_lost_is_no_success(run, slide, calibration_file, tmp_path):
    for k in range(5):
        (tmp_path / f"{k}.png").write_bytes((slide / f"{0 if k < 4 else 2:03d}.png").read_bytes())
    code, out, err = run("track", tmp_path, "-c", calibration_file, "-o", tmp_path / "t.csv")
    assert code == 3
    assert "the object was lost in 4 of 5 frames" in " ".join(err.split())
    assert ["no", "contact", "4"] in [line.split() for line in out.splitlines()]
