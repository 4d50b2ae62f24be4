"""gelform starter: a calibration of a unit from its background image; gelform info describes it."""

import numpy as np
import pytest

from gelform.calibration.starters import load_starter
from gelform.calibration_file import load_calibration
from gelform.exchange.plots.canvas import save_picture
from gelform.simulate import LAYOUTS, Ball, simulate_background, simulate_press

SIMULATED = "simulated-three-edges"


@pytest.fixture(scope="module")
def unit(tmp_path_factory):
    """A folder with an image of the gel at rest, and one of a ball 0.4 mm deep."""
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
    assert said["starter"].startswith(f"starter of the make {SIMULATED}")
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


@pytest.fixture
def no_library(tmp_path, monkeypatch):
    monkeypatch.setenv("GELFORM_CALIBRATIONS", str(tmp_path / "none"))


@pytest.mark.usefixtures("no_library")
def test_commands_take_the_starter_of_a_make(run, run_json, unit, tmp_path):
    how = ("--sensor", SIMULATED, "--background", unit / "rest.png")
    (row,) = run_json("reconstruct", unit / "frame.png", *how, "-o", tmp_path / "out")["results"]
    assert row["peak_mm"] == pytest.approx(0.4, abs=0.08)
    (row,) = run_json("explain", unit / "frame.png", *how, "--mm-per-px", "0.05")["images"]
    assert row["trusted_share"] > 0.5
    done = run_json("batch", unit, *how, "-o", tmp_path / "depths")
    assert (done["frames"], done["errors"]) == (1, 0)
    again = run_json("batch", unit, *how, "-o", tmp_path / "depths")  # the same starter: it goes on
    assert (again["frames"], again["frames_before"]) == (0, 1)
    code, _, err = run("bag", unit, *how, "-o", tmp_path / "bag")
    assert (code, "Calibration: the starter of a" in err) == (0, True), err


@pytest.mark.usefixtures("no_library")
@pytest.mark.parametrize("command", ["reconstruct", "explain", "batch", "bag"])
def test_what_a_starter_needs_is_said_before_any_work(fails, unit, tmp_path, command):
    image, rest, out = unit / "frame.png", unit / "rest.png", ("-o", tmp_path / "out")
    said = fails(command, image, "--sensor", SIMULATED, *out, status=2)
    assert "--background" in said
    assert "an image of the gel at rest" in said
    said = fails(command, image, "--sensor", "gelslim", "--background", rest, *out, status=2)
    assert "expected digit, gelsight-mini or simulated-three-edges, got 'gelslim'" in said
    assert "Leave one" in fails(command, image, "--sensor", SIMULATED, "-c", rest, *out, status=2)
    assert "--sensor" in fails(command, image, "--mm-per-px", "0.05", *out, status=2)
    given = unit if command in ("batch", "bag") else image
    assert "take a starter" in fails(command, given, "--background", rest, *out)
    assert not (tmp_path / "out").exists()


def test_the_library_comes_before_the_starter(run, unit, tmp_path, monkeypatch):
    from gelform.calibration.library import add_calibration

    monkeypatch.setenv("GELFORM_CALIBRATIONS", str(tmp_path / "library"))
    rest = unit / "rest.png"
    how = (SIMULATED, "--background", rest)
    run("starter", *how, "-o", tmp_path / "mine.npz", "--serial", "S9", "--gel", "mine")
    add_calibration(load_calibration(tmp_path / "mine.npz"))
    folder = tmp_path / "frames"
    folder.mkdir()
    (folder / "frame.png").write_bytes((unit / "frame.png").read_bytes())
    (folder / "sensor.toml").write_text(f'name = "{SIMULATED}"\nmm_per_px = 0.0634\nserial = "S9"\n')
    code, _, err = run("reconstruct", folder / "frame.png", "--sensor", *how, "-o", tmp_path / "out")
    assert (code, "gel mine" in err) == (0, True), err
