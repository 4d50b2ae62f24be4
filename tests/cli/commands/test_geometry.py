"""gelform scale and gelform lens: their results and refusals."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform.calibration_file import load_calibration
from gelform.exchange.plots.canvas import save_picture
from gelform.sensors.files import read_sensor_toml
from gelform.simulate import Ball, simulate_background, simulate_press
from made.checkerboard import checkerboard


@pytest.fixture(scope="module")
def images(small, tmp_path_factory):
    """A ball, pressed into the sensor behind the press folder at two places 3.9 mm apart."""
    folder = tmp_path_factory.mktemp("measured")
    rng = np.random.default_rng(4)
    for name, center in (("left", (-2.0, -0.5)), ("right", (1.6, 1.0))):
        press = simulate_press(small, Ball(3.0), depth_mm=0.4, center_mm=center, rng=rng, oversample=1)
        save_picture(folder / f"{name}.png", press.image)
    return folder


@pytest.mark.slow
def test_a_measured_scale_reaches_the_calibration(run, run_json, folder, images, small, tmp_path):
    pressed = f"{images / 'left.png'},{images / 'right.png'},3.9"
    far = 17 / small.mm_per_px
    given = ("--stage", pressed, "--points", f"0,0,{far},0,17")
    said = run_json("scale", folder, *given)
    assert said["file"] == str(folder / "sensor.toml")
    assert said["mm_per_px"] == pytest.approx(small.mm_per_px, rel=0.015)
    assert abs(said["mm_per_px"] - small.mm_per_px) < 3 * said["mm_per_px_sigma"]
    settings = read_sensor_toml(folder / "sensor.toml")
    assert settings.mm_per_px == pytest.approx(said["mm_per_px"])
    assert settings.mm_per_px_sigma == pytest.approx(said["mm_per_px_sigma"])
    assert run("calibrate", folder, "-o", tmp_path / "cal.npz", "--model", "polynomial")[0] == 0
    calibration = load_calibration(tmp_path / "cal.npz")
    assert calibration.mm_per_px == pytest.approx(said["mm_per_px"])
    assert "two points" in calibration.settings["scale_source"]
    assert "a stage step of 3.9 mm" in calibration.settings["scale_source"]


def test_marked_points(run, folder):
    code, _, err = run("scale", folder, "--points", "20,10,100,70,12")
    assert code == 0
    assert read_sensor_toml(folder / "sensor.toml").mm_per_px == pytest.approx(0.12)
    assert "0.12 +- " in err


def test_points_given_twice_are_averaged_or_compared(run, fails, folder):
    code, _, err = run("scale", folder, "--points", "20,10,100,10,9.6", "--points", "20,10,20,90,9.7")
    assert code == 0
    assert read_sensor_toml(folder / "sensor.toml").mm_per_px == pytest.approx(0.1206, abs=1e-4)
    assert err.count("two points") == 2
    block = ("--points", "20,10,101.9,10,7", "--points", "20,10,20,64,5")
    assert "pixels are not square: mm_per_px = [0.08547, 0.092593]" in fails("scale", folder, *block)


def test_a_scale_that_no_gel_has_is_not_written(run, fails, folder, imported):
    """Ten times too small: 160 px would be 2 mm."""
    for place in (folder, imported):
        before = (folder / "sensor.toml" if place == folder else place).read_bytes()
        named = fails("scale", place, "--points", "20,10,100,70,1.25")
        assert "between 3 and 150 mm wide, got 160 px of 0.0125 mm: 2 mm" in named
        assert (folder / "sensor.toml" if place == folder else place).read_bytes() == before
        code, _, err = run("scale", place, "--points", "20,10,100,70,2.5")
        assert code == 0
        assert "this one would be 160 px of 0.025 mm: 4 mm" in " ".join(err.split())


def test_what_cannot_be_is_refused_and_nothing_changes(fails, folder, images, calibration_file):
    before = [path.read_bytes() for path in (folder / "sensor.toml", calibration_file)]
    assert "sensor.toml" in fails("scale", calibration_file, "--points", "20,10,100,70,12")
    for arguments, text, status in (
        ((), "--points, --stage or both", 2),
        (("--points", "1,2,3"), "X1,Y1,X2,Y2,MM", 2),
        (("--stage", "left.png,2"), "A,B,MM", 2),
        (("--points", "1,1,2,2,5"), "--points: Expected two points at least", 1),
        (("--points", "20,10,100,70,-12"), "--points: Expected distance_mm > 0", 1),
        (("--stage", "nothing.png,nor.png,1"), "No file", 1),
        (
            ("--points", "20,10,100,70,12", "--stage", f"{images / 'left.png'},{images / 'right.png'},8"),
            "agree",
            1,
        ),
    ):
        assert text in fails("scale", folder, *arguments, status=status)
    assert [path.read_bytes() for path in (folder / "sensor.toml", calibration_file)] == before


@pytest.fixture
def presses(press_folder, tmp_path):
    """A copy of the press folder, to be changed."""
    ignored = shutil.ignore_patterns("truth")
    return shutil.copytree(press_folder, tmp_path / "presses", ignore=ignored)


@pytest.fixture
def folder(presses):
    """The press folder with a scale that is wrong by half."""
    text = (presses / "sensor.toml").read_text().replace("mm_per_px = 0.1268", "mm_per_px = 0.19  # a guess")
    assert "a guess" in text
    (presses / "sensor.toml").write_text(text)
    return presses


@pytest.fixture
def leds(small, tmp_path):
    """Frames of the red, green and blue LEDs alone."""
    rng, paths = np.random.default_rng(4), []
    for k, name in enumerate(("red", "green", "blue")):
        lit = tuple(led for led in small.leds if int(np.argmax(led.color)) == k)
        paths.append(tmp_path / f"{name}.png")
        save_picture(paths[-1], simulate_background(replace(small, leds=lit, ambient=(0, 0, 0)), rng))
    return paths


def test_a_grid_tells_lens_and_scale(run_json, presses, tmp_path):
    checkerboard(tmp_path / "grid.png", (120, 160), 12)
    said = run_json("lens", presses, "--image", tmp_path / "grid.png", "--grid", "8x6", "--pitch-mm", "1.2")
    assert said["mm_per_px"] == pytest.approx(0.1, rel=0.005)
    settings = read_sensor_toml(presses / "sensor.toml")
    assert settings.mm_per_px == pytest.approx(said["mm_per_px"])
    assert settings.view.lens is not None
    assert settings.view.frame_shape == (120, 160)


@pytest.mark.slow
def test_crosstalk_reaches_the_calibration(run, run_json, presses, leds, tmp_path):
    said = run_json("crosstalk", presses, *leds)
    assert said["matrix"][1][0] > 0.05
    turned = [tmp_path / led.name for led in leds]
    for led, path in zip(leds, turned):
        cv2.imwrite(str(path), cv2.imread(str(led))[..., ::-1])
    assert run_json("crosstalk", presses, *turned, "--bgr")["matrix"] == said["matrix"]
    made = run_json("calibrate", presses, "-o", tmp_path / "cal.npz", "--model", "polynomial")
    calibration = load_calibration(tmp_path / "cal.npz")
    np.testing.assert_allclose(calibration.change.crosstalk, said["matrix"], atol=1e-6)
    assert any("gelform removes" in note for note in made["notes"])


def test_a_lens_that_cannot_be_is_refused_and_nothing_changes(fails, presses, leds):
    before = (presses / "sensor.toml").read_bytes()
    image = ("--image", leds[0])
    for arguments, text, status in (
        ((), "Missing option", 2),
        (image, "Missing option", 2),
        (("--grid", "9x6"), "Missing option", 2),
        ((*image, "--grid", "nine", "--pitch-mm", "1"), "COLUMNSxROWS", 2),
        ((*image, "--grid", "9x6", "--pitch-mm", "0"), "expected a number > 0", 2),
        ((*image, "--grid", "9x6", "--pitch-mm", "1"), "found none", 1),
        ((*image, "--grid", "1x6", "--pitch-mm", "1"), "--grid: Expected kind", 1),
    ):
        assert text in fails("lens", presses, *arguments, status=status)
    assert "brightest in red" in fails("crosstalk", presses, leds[1], leds[0], leds[2], status=1)
    assert (presses / "sensor.toml").read_bytes() == before
