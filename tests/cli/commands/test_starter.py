"""gelform starter: a calibration of a unit from its untouched image; gelform info says what it is."""

import numpy as np
import pytest

from gelform.calibration_file import load_calibration
from gelform.plots.canvas import save_picture
from gelform.simulate import LAYOUTS, Ball, simulate_background, simulate_press
from gelform.starters import load_starter

SIMULATED = "simulated-three-edges"


@pytest.fixture(scope="module")
def unit(tmp_path_factory):
    """A folder with an image of the untouched gel, and one of a ball 0.4 mm deep."""
    folder, layout = tmp_path_factory.mktemp("unit"), LAYOUTS["three-edges"]
    rest = simulate_background(layout, np.random.default_rng(5)).round().astype(np.uint8)
    pressed = simulate_press(layout, Ball(2.5), depth_mm=0.4, rng=np.random.default_rng(6)).image
    for name, image in (("rest", rest), ("frame", pressed)):
        save_picture(folder / f"{name}.png", image)
    return folder


def test_a_starter_is_a_calibration_that_every_command_takes(run, run_json, unit, tmp_path):
    file = tmp_path / "unit.npz"
    said = run_json(
        "starter", SIMULATED, "--background", unit / "rest.png", "-o", file, "--serial", "S1", "--gel", "g2"
    )
    calibration = load_calibration(file)
    assert (calibration.serial, calibration.gel_id) == ("S1", "g2")
    assert said["digest"] == calibration.digest
    assert said["settings"]["starter"]["spread"] == load_starter(SIMULATED).spread
    (row,) = run_json("reconstruct", unit / "frame.png", "-c", file, "-o", tmp_path / "out")["results"]
    assert row["peak_mm"] == pytest.approx(0.4, abs=0.08)
    assert "starter" in [finding["name"] for finding in row["findings"]]


def test_what_it_is_is_said_when_it_is_made_and_by_info(run, unit, tmp_path):
    file = tmp_path / "unit.npz"
    code, _, err = run("starter", SIMULATED, "--background", unit / "rest.png", "-o", file)
    spread = f"{100 * load_starter(SIMULATED).spread:.0f} %"
    assert code == 0
    assert f"may be off by {spread}" in err
    lines = dict(line.split("  ", 1) for line in run("info", file)[1].splitlines())
    said = {label.strip(): text.strip() for label, text in lines.items()}
    assert said["starter"].startswith(f"of the make {SIMULATED}")
    assert said["made from"] == "; ".join(load_starter(SIMULATED).units)
    assert spread in said["spread"]


def test_another_make_and_other_mistakes_are_said(fails, unit, tmp_path):
    rest, file = unit / "rest.png", tmp_path / "unit.npz"
    assert "expected digit, gelsight-mini or" in fails(
        "starter", "gelslim", "--background", rest, "-o", file, status=2
    )
    assert "--background" in fails("starter", SIMULATED, "-o", file, status=2)
    said = fails("starter", "gelsight-mini", "--background", rest, "-o", file)
    assert "rest.png" in said
    assert "GelSight Mini" in said
    file.write_bytes(b"")
    assert "already there" in fails("starter", SIMULATED, "--background", rest, "-o", file)
