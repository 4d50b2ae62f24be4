"""gelform lens: a grid and single LEDs, into sensor.toml."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform.calibration_file import load_calibration
from gelform.plots.canvas import save_picture
from gelform.sensors.files import read_sensor_toml
from gelform.simulate import simulate_background


@pytest.fixture
def folder(press_folder, tmp_path):
    copy = tmp_path / "presses"
    shutil.copytree(press_folder, copy, ignore=shutil.ignore_patterns("truth"))
    return copy


@pytest.fixture
def leds(small, tmp_path):
    """Frames of the red, green and blue LEDs alone."""
    rng, paths = np.random.default_rng(4), []
    for k, name in enumerate(("red", "green", "blue")):
        lit = tuple(led for led in small.leds if int(np.argmax(led.color)) == k)
        paths.append(tmp_path / f"{name}.png")
        save_picture(paths[-1], simulate_background(replace(small, leds=lit, ambient=(0, 0, 0)), rng))
    return paths


def checkerboard(path, shape, square_px):
    """A checkerboard of 8x6 inner corners in the middle of a frame, white around it."""
    fine = 8
    board = np.kron(np.indices((7, 9)).sum(axis=0) % 2, np.ones((square_px * fine,) * 2))
    whole = np.ones((shape[0] * fine, shape[1] * fine))
    top, left = ((whole.shape[k] - board.shape[k]) // 2 for k in (0, 1))
    whole[top : top + board.shape[0], left : left + board.shape[1]] = board
    grey = cv2.resize(whole, shape[::-1], interpolation=cv2.INTER_AREA)
    save_picture(path, np.repeat((40 + 180 * grey).astype(np.uint8)[..., None], 3, axis=2))


def test_a_grid_tells_lens_and_scale(run_json, folder, tmp_path):
    checkerboard(tmp_path / "grid.png", (120, 160), 12)
    said = run_json("lens", folder, "--image", tmp_path / "grid.png", "--grid", "8x6", "--pitch-mm", "1.2")
    assert said["mm_per_px"] == pytest.approx(0.1, rel=0.005)
    settings = read_sensor_toml(folder / "sensor.toml")
    assert settings.mm_per_px == pytest.approx(said["mm_per_px"])
    assert settings.view.lens is not None
    assert settings.view.frame_shape == (120, 160)


@pytest.mark.slow
def test_crosstalk_reaches_the_calibration(run, run_json, folder, leds, tmp_path):
    said = run_json("lens", folder, "--led-frames", *leds)
    assert said["matrix"][1][0] > 0.05
    made = run_json("calibrate", folder, "-o", tmp_path / "cal.npz", "--model", "polynomial")
    calibration = load_calibration(tmp_path / "cal.npz")
    np.testing.assert_allclose(calibration.change.crosstalk, said["matrix"], atol=1e-6)
    assert any("Crosstalk is undone" in note for note in made["notes"])


def test_wrong_options_are_usage(fails, folder, leds):
    for arguments, text in (
        ((), "--image or --led-frames"),
        (("--image", leds[0]), "all three or none"),
        (("--grid", "9x6"), "all three or none"),
        (("--image", leds[0], "--grid", "nine", "--pitch-mm", "1"), "COLUMNSxROWS"),
        (("--image", leds[0], "--grid", "9x6", "--pitch-mm", "0"), "expected a number > 0"),
    ):
        assert text in fails("lens", folder, *arguments, status=2)


def test_what_cannot_be_is_refused_and_nothing_changes(fails, folder, leds, calibration_file):
    before = (folder / "sensor.toml").read_bytes()
    grid = ("--grid", "9x6", "--pitch-mm", "1")
    assert "found none" in fails("lens", folder, "--image", leds[0], *grid)
    assert "--grid: Expected kind" in fails(
        "lens", folder, "--image", leds[0], "--grid", "1x6", "--pitch-mm", "1"
    )
    assert "brightest in red" in fails("lens", folder, "--led-frames", leds[1], leds[0], leds[2])
    assert (folder / "sensor.toml").read_bytes() == before
