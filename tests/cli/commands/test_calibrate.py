"""gelform calibrate: from a folder to a calibration and a report; every missing file is named.

gelform starter: a calibration of a unit from its background image; gelform info describes it.
"""

import csv
import json
import re
import shutil
import time

import numpy as np
import pytest

from gelform.calibration import report
from gelform.calibration.presses.folder import read_presses
from gelform.calibration.starters import load_starter
from gelform.calibration_file import load_calibration
from gelform.exchange.plots import save_picture
from gelform.simulate import LAYOUTS, Ball, Pose, simulate_background, simulate_press, simulate_sequence
from made.files import video


def test_a_calibration_and_its_report_whose_circles_can_be_labels(works, folder, tmp_path):
    output, pages = tmp_path / "cal.npz", tmp_path / "deep" / "report"
    how = ("--report", pages, "--model", "polynomial", "--json")
    out, err = works("calibrate", folder, "-o", output, *how)
    said = json.loads(out)
    calibration = load_calibration(output)
    assert calibration.image_shape == (120, 160)
    assert said["held_out"]["normal_free_deg"] == calibration.held_out["normal_free_deg"] < 6
    assert sorted(path.name for path in pages.iterdir()) == ["circles.csv", "report.html", "report.json"]
    content = json.loads((pages / "report.json").read_text(encoding="utf-8"))
    assert content["held_out"]["normal_free_deg"] == calibration.held_out["normal_free_deg"]
    assert content["calibration"]["digest"] == calibration.digest
    verdict, held_out = content["verdict"], said["held_out"]
    assert verdict["headline"] in (pages / "report.html").read_text(encoding="utf-8")
    assert said["verdict"] == verdict
    assert f"gelform calibrations add {output} --serial SERIAL\n" in err
    lines = err.splitlines()
    assert lines[:2] == [f"{verdict['headline']}.", f"Next: {verdict['next']}"]
    assert lines[2].startswith("small: 10 of 10 presses used; depth on held-out presses is off by ")
    for name in ("cap_free_um", "off_contact_um"):
        assert f"{held_out[name]:.3g} um" in lines[2]
    assert re.fullmatch(rf"Wrote {output} and {pages}/report.html in \d+ s\.", lines[3])
    truth = [press.label for press in read_presses(folder).presses]
    with (pages / "circles.csv").open() as file:
        rows = list(csv.DictReader(file))
    found = [(float(row["center_x_px"]), float(row["center_y_px"])) for row in rows]
    assert np.median(np.hypot(*(np.array(found) - np.array(truth)[:, :2]).T)) < 1.5
    shutil.copy(pages / "circles.csv", folder / "presses.csv")
    assert all(press.label is not None for press in read_presses(folder).presses)


def test_tables_are_shown_only_if_asked_for(works, folder, tmp_path):
    (folder / "images" / "0003.png").write_bytes((folder / "background.png").read_bytes())
    how = ("--model", "polynomial", "--overwrite", "-o", tmp_path / "cal.npz")
    out, err = works("calibrate", folder, *how)
    assert (out, len(err.splitlines())) == ("", 5)
    assert "9 of 10 presses used" in err
    out, err = works("calibrate", folder, *how, "--verbose")
    tables = ("Rejected presses", "images/0003.png", "Color models tried", "Errors on held-out presses")
    assert all(table in out for table in tables)
    assert "note: " in err
    assert works("calibrate", folder, *how, "--verbose", "--quiet") == ("", "")


def test_the_time_is_that_of_the_whole_command(run, folder, tmp_path, monkeypatch):
    """Of the report too, which takes as long as the calibration."""
    now, later = time.monotonic, 0.0
    made = report.report_page

    def slow_page(*given):
        nonlocal later
        later = 1000.0
        return made(*given)

    monkeypatch.setattr(report, "report_page", slow_page)
    monkeypatch.setattr(time, "monotonic", lambda: now() + later)
    how = ("--model", "polynomial", "-o", tmp_path / "cal.npz", "--report", tmp_path / "report")
    _, _, err = run("calibrate", folder, *how)
    assert 1000 <= int(re.search(r" in (\d+) s\.", err)[1]) < 2000


def test_images_without_a_ball(fails, folder, small, tmp_path):
    rng = np.random.default_rng(0)
    for path in (folder / "images").iterdir():
        save_picture(path, np.rint(simulate_background(small, rng)).astype(np.uint8), overwrite=True)
    said = fails("calibrate", folder, "-o", tmp_path / "cal.npz")
    assert "Expected at least 3 presses of a ball that fit, got 0 of 10" in said
    assert not (tmp_path / "cal.npz").exists()


@pytest.mark.slow
def test_a_video(works, small, tmp_path):
    rng, poses = np.random.default_rng(1), [Pose(-1)] * 12
    for x, y in np.stack(np.meshgrid([-5, 0, 5], [-3.5, 0, 3.5]), axis=-1).reshape(-1, 2):
        poses += [*[Pose(0.7, (x, y))] * 7, *[Pose(-1)] * 5]
    images = [press.image for press in simulate_sequence(small, Ball(3), poses, rng=rng)]
    path = video(tmp_path / "presses.avi", images)
    given = ("--mm-per-px", small.mm_per_px, "--ball-diameter-mm", 6)
    err = works("calibrate", path, "-o", tmp_path / "cal.npz", "--model", "polynomial", *given)[1]
    assert "9 of 9 presses used" in err
    assert load_calibration(tmp_path / "cal.npz").image_shape == small.shape


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


def test_a_starter_is_a_calibration_that_every_command_takes(works, run_json, unit, tmp_path):
    file, starter = tmp_path / "unit.npz", load_starter(SIMULATED)
    how = ("--background", unit / "rest.png", "-o", file, "--serial", "S1", "--gel", "g2")
    spread = f"{100 * starter.spread:.0f} %"
    assert f"may be off by {spread}" in works("starter", SIMULATED, *how)[1]
    said = run_json("starter", SIMULATED, *how, "--overwrite")
    calibration = load_calibration(file)
    assert (calibration.serial, calibration.gel_id) == ("S1", "g2")
    assert said["digest"] == calibration.digest
    assert said["settings"]["starter"]["spread"] == starter.spread
    lines = dict(line.split("  ", 1) for line in works("info", file)[0].splitlines())
    described = {label.strip(): text.strip() for label, text in lines.items()}
    assert described["starter"].startswith(f"starter of the make {SIMULATED}")
    assert described["made from"] == "; ".join(starter.units)
    assert spread in described["spread"]
    (row,) = run_json("reconstruct", unit / "frame.png", "-c", file, "-o", tmp_path / "out")["results"]
    assert row["peak_mm"] == pytest.approx(0.4, abs=0.08)
    assert "starter" in [finding["name"] for finding in row["findings"]]


@pytest.mark.usefixtures("library")
def test_commands_take_the_starter_of_a_make(works, run_json, unit, tmp_path):
    how = ("--sensor", SIMULATED, "--background", unit / "rest.png")
    (row,) = run_json("reconstruct", unit / "frame.png", *how, "-o", tmp_path / "out")["results"]
    assert row["peak_mm"] == pytest.approx(0.4, abs=0.08)
    (row,) = run_json("explain", unit / "frame.png", *how, "--mm-per-px", "0.05")["images"]
    assert row["trusted_share"] > 0.5
    done = run_json("batch", unit, *how, "-o", tmp_path / "depths")
    assert (done["frames"], done["errors"]) == (1, 0)
    again = run_json("batch", unit, *how, "-o", tmp_path / "depths")  # the same starter: it goes on
    assert (again["frames"], again["frames_before"]) == (0, 1)
    assert "Calibration: the starter of a" in works("bag", unit, *how, "-o", tmp_path / "bag")[1]


@pytest.mark.usefixtures("library")
def test_the_library_comes_before_the_starter(works, unit, tmp_path):
    how = (SIMULATED, "--background", unit / "rest.png")
    works("starter", *how, "-o", tmp_path / "mine.npz", "--serial", "S9", "--gel", "mine")
    works("calibrations", "add", tmp_path / "mine.npz")
    (tmp_path / "frame.png").write_bytes((unit / "frame.png").read_bytes())
    (tmp_path / "sensor.toml").write_text(f'name = "{SIMULATED}"\nmm_per_px = 0.0634\nserial = "S9"\n')
    given = ("reconstruct", tmp_path / "frame.png", "--sensor", *how, "-o", tmp_path / "out")
    assert "gel mine" in works(*given)[1]
