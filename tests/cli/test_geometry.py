"""calibrate's options that measure scale and crosstalk: what they say ends in the calibration."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration_file import load_calibration
from gelform.plots.canvas import save_picture
from gelform.simulate import Punch, Screw, simulate_background, simulate_press

SMALL_PITCH = 0.1268


@pytest.fixture(scope="module")
def images(press_folder, tmp_path_factory):
    """A punch, a thread and LED frames of the sensor behind the press folder."""
    from conftest import SMALL  # the commands' own

    folder = tmp_path_factory.mktemp("measured")
    rng = np.random.default_rng(4)
    for name, thing in (("punch", Punch(7.0)), ("thread", Screw(8, 1.25, 30))):
        save_picture(
            folder / f"{name}.png", simulate_press(SMALL, thing, depth_mm=0.4, rng=rng, oversample=1).image
        )
    for k, name in enumerate(("red", "green", "blue")):
        lit = tuple(led for led in SMALL.leds if int(np.argmax(led.color)) == k)
        save_picture(
            folder / f"{name}.png", simulate_background(replace(SMALL, leds=lit, ambient=(0, 0, 0)), rng)
        )
    return folder


def test_scale_and_crosstalk_are_measured(run_json, press_folder, images, tmp_path):
    said = run_json(
        *("calibrate", press_folder, "-o", tmp_path / "cal.npz", "--model", "polynomial"),
        *("--punch", f"{images / 'punch.png'},7", "--thread", f"{images / 'thread.png'},1.25"),
        *("--led-frames", images / "red.png", images / "green.png", images / "blue.png"),
    )
    calibration = load_calibration(tmp_path / "cal.npz")
    assert calibration.mm_per_px == pytest.approx(SMALL_PITCH, rel=0.015)
    assert abs(calibration.mm_per_px - SMALL_PITCH) < 3 * calibration.mm_per_px_sigma
    assert "a punch of 7 mm" in calibration.settings["scale_source"]
    assert "a thread of pitch 1.25 mm" in calibration.settings["scale_source"]
    assert calibration.change.crosstalk[1][0] > 0.05
    assert calibration.describe()["crosstalk"] == calibration.change.crosstalk
    assert any("Crosstalk is undone" in note for note in said["notes"])


def test_wrong_options_are_usage_errors(fails, press_folder, tmp_path):
    start = ("calibrate", press_folder, "-o", tmp_path / "cal.npz")
    assert "X1,Y1,X2,Y2,MM" in fails(*start, "--scale-points", "1,2,3", status=2)
    assert "IMG,MM" in fails(*start, "--punch", "punch.png", status=2)
    assert "--grid and --pitch-mm" in fails(*start, "--lens-images", "grid.png", status=2)
    assert "--lens-images" in fails(*start, "--grid", "9x6", status=2)
    assert "no other source" in fails(*start, "--scale-points", "1,2,90,2,5", "--mm-per-px", "1", status=2)
    assert "No file" in fails(*start, "--thread", "nothing.png,1")
