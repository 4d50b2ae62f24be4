"""gelform calibrate: from a folder to a calibration and a report; every missing file is named.

gelform starter: a calibration of a unit from its background image; gelform info describes it.

gelform scale and gelform lens: their results and refusals.

gelform force calibrate and evaluate: what they write and print, and what they refuse.
"""

import csv
import json
import re
import shutil
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration import report
from gelform.calibration.presses.folder import read_presses
from gelform.calibration.report.content import LIMITS
from gelform.calibration.starters import load_starter
from gelform.calibration_file import load_calibration
from gelform.cli.commands.calibrate import _with_places
from gelform.exchange.plots import save_picture
from gelform.sensors.files import read_sensor_toml
from gelform.simulate import LAYOUTS, Ball, Pose, simulate_background, simulate_press, simulate_sequence
from made.images import checkerboard
from made.sources import video_file


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
    lines = lines[lines.index(f"{verdict['headline']}.") :]
    assert lines[1:3] == [
        f"Next: {_with_places(verdict['next'], content['coverage']['next'])}", f"Checks: {verdict['checks']}.",
    ]  # fmt: skip
    lying = re.match(r"small: 10 of 10 presses used \((.*)\); depth on held-out presses is off by ", lines[3])
    assert sum(int(one.split()[-1]) for one in lying[1].split(", ")) == 10
    assert {one.rsplit(" ", 1)[0] for one in lying[1].split(", ")} >= {"right", "bottom"}
    for name in ("cap_free_um", "off_contact_um"):
        assert f"{held_out[name]:.3g} um" in lines[3]
    assert re.fullmatch(rf"Wrote {output} and {pages}/report.html in \d+ s\.", lines[4])
    truth = [press.label for press in read_presses(folder).presses]
    with (pages / "circles.csv").open() as file:
        rows = list(csv.DictReader(file))
    found = [(float(row["center_x_px"]), float(row["center_y_px"])) for row in rows]
    assert np.median(np.hypot(*(np.array(found) - np.array(truth)[:, :2]).T)) < 1.5
    shutil.copy(pages / "circles.csv", folder / "presses.csv")
    assert all(press.label is not None for press in read_presses(folder).presses)


def test_a_terminal_names_the_pixels_of_places_that_the_report_marks():
    places = [
        {"name": "top left", "x_px": 39.8, "y_px": 30.2}, {"name": "right", "x_px": 140.0, "y_px": 60.0},
    ]  # fmt: skip
    for marked in ("Press at the places marked 1, 2, 3. Look.", "Press at places 1, 2, 3. Look."):
        said = _with_places(marked, places)
        assert said == "Press at pixels (x, y) top left (40, 30), right (140, 60). Look."
        assert "1, 2, 3" not in _with_places(marked, [])
    assert all("1, 2, 3" not in _with_places(one.action, places) for one in LIMITS)


def test_tables_are_shown_only_if_asked_for(works, folder, tmp_path, monkeypatch):
    """The second command takes the circles that the first one kept; `--fresh` keeps none."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (folder / "images" / "0003.png").write_bytes((folder / "background.png").read_bytes())
    how = ("--model", "polynomial", "--overwrite", "-o", tmp_path / "cal.npz")
    assert works("calibrate", folder, *how, "--fresh", "--quiet") == ("", "")
    assert not list((tmp_path / "cache").rglob("*.json"))
    fresh = load_calibration(tmp_path / "cal.npz").held_out
    out, err = works("calibrate", folder, *how)
    assert len(list((tmp_path / "cache" / "gelform" / "circles").glob("*.json"))) == 10
    assert fresh == load_calibration(tmp_path / "cal.npz").held_out
    assert (out, len(err.splitlines())) == ("", 6)
    assert "9 of 10 presses used" in err
    out, err = works("calibrate", folder, *how, "--verbose")
    tables = ("Rejected presses", "images/0003.png", "Color models tried", "Errors on held-out presses")
    assert all(table in out for table in tables)
    assert "note: " in err
    assert fresh == load_calibration(tmp_path / "cal.npz").held_out


def test_a_poor_result_shows_its_notes(works, folder, tmp_path):
    """They may name the cause; here every second press's ball is stated too large."""
    with (folder / "presses.csv").open() as file:
        rows = list(csv.DictReader(file))
    with (folder / "presses.csv").open("w") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        for k, row in enumerate(rows):
            writer.writerow({**row, "ball_diameter_mm": (1 + 0.6 * (k % 2)) * float(row["ball_diameter_mm"])})
    _, err = works("calibrate", folder, "--model", "polynomial", "-o", tmp_path / "cal.npz")
    assert "Poor" in err
    assert "note: " in err


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
    assert len(re.findall(r"\.(?= |$)", said)) <= 4, "sentences"
    assert not (tmp_path / "cal.npz").exists()


@pytest.mark.slow
def test_a_video(works, small, tmp_path):
    rng, poses = np.random.default_rng(1), [Pose(-1)] * 12
    for x, y in np.stack(np.meshgrid([-5, 0, 5], [-3.5, 0, 3.5]), axis=-1).reshape(-1, 2):
        poses += [*[Pose(0.7, (x, y))] * 7, *[Pose(-1)] * 5]
    images = [press.image for press in simulate_sequence(small, Ball(3), poses, rng=rng)]
    path = video_file(tmp_path / "presses.avi", images, "FFV1")
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


def test_marked_points_are_averaged_or_compared(works, fails, folder):
    before = read_sensor_toml(folder / "sensor.toml").mm_per_px
    err = works("scale", folder, "--points", "20,10,100,70,12")[1]
    assert "0.12 +- " in err
    assert f"sensor.toml, in the place of {before:.5g}." in err, "a ruler that was read wrong stands out"
    assert read_sensor_toml(folder / "sensor.toml").mm_per_px == pytest.approx(0.12)
    err = works("scale", folder, "--points", "20,10,100,10,9.6", "--points", "20,10,20,90,9.7")[1]
    assert read_sensor_toml(folder / "sensor.toml").mm_per_px == pytest.approx(0.1206, abs=1e-4)
    assert err.count("two points") == 2
    block = ("--points", "20,10,101.9,10,7", "--points", "20,10,20,64,5")
    assert "pixels are not square: mm_per_px = [0.08547, 0.092593]" in fails("scale", folder, *block)


def test_a_scale_that_no_gel_has_is_not_written(works, fails, folder, imported):
    """Ten times too small: 160 px would be 2 mm."""
    for place, file in ((folder, folder / "sensor.toml"), (imported, imported)):
        before = file.read_bytes()
        named = fails("scale", place, "--points", "20,10,100,70,1.25")
        assert "between 3 and 150 mm wide, got 160 px of 0.0125 mm: 2 mm" in named
        assert file.read_bytes() == before
        err = works("scale", place, "--points", "20,10,100,70,2.5")[1]
        assert "this one would be 160 px of 0.025 mm: 4 mm" in err


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
    said = run_json("crosstalk", folder, *leds)
    assert said["matrix"][1][0] > 0.05
    turned = [tmp_path / led.name for led in leds]
    for led, path in zip(leds, turned):
        save_picture(path, cv2.imread(str(led)))
    assert run_json("crosstalk", folder, *turned, "--bgr")["matrix"] == said["matrix"]
    made = run_json("calibrate", folder, "-o", tmp_path / "cal.npz", "--model", "polynomial")
    calibration = load_calibration(tmp_path / "cal.npz")
    np.testing.assert_allclose(calibration.change.crosstalk, said["matrix"], atol=1e-6)
    assert any("gelform removes" in note for note in made["notes"])


K = 0.05  # N per mm^3


@pytest.fixture(scope="module")
def loads(small, calibration_file, tmp_path_factory):
    """Two balls with four loads each, K times the volume that the calibration reads."""
    folder, rng = tmp_path_factory.mktemp("loads"), np.random.default_rng(9)
    reconstruct, lines = gelform.Reconstructor(gelform.load_calibration(calibration_file)), []
    for radius in (2.5, 4.0):
        for depth in (0.15, 0.25, 0.35, 0.5):
            at = {"depth_mm": depth, "center_mm": (0.4, -0.3)}
            image = simulate_press(small, Ball(radius), **at, rng=rng, oversample=1).image
            save_picture(folder / f"{radius}-{depth}.png", image)
            volume_mm3 = gelform.touch_from_result(reconstruct(image)).volume_mm3
            lines.append(f"{radius}-{depth}.png,ball {radius},{K * volume_mm3}")
    (folder / "loads.csv").write_text("\n".join(["image,object,force_n", *lines, ""]))
    return folder


def test_loads_are_added_to_the_calibration_and_measured(
    run, works, run_json, fails, loads, calibration_file, tmp_path
):
    own = Path(shutil.copy(calibration_file, tmp_path / "cal.npz"))
    before = own.read_bytes()
    assert "is already there" in fails("force", "calibrate", loads, "-c", own)
    assert own.read_bytes() == before
    said = run_json("force", "calibrate", loads, "-c", own, "--overwrite")
    assert said["normal"]["weights"] == [[pytest.approx(K)]]
    assert said["unit"] == "N"
    assert gelform.load_calibration(own).force.normal.loads == said["normal"]["loads"]
    errors = run_json("force", "evaluate", loads, "-c", own)
    assert re.search(r"^force +\d loads up to", run("info", own)[1], re.M)
    assert errors["normal"][-1]["mae"] < 0.01 < errors["normal"][-1]["constant"]["mae"]
    out, err = works("force", "evaluate", loads, "-c", own)
    assert "constant's (N)" in " ".join(out.split())
    assert out.count("(%)") == 5
    whole = next(line.split() for line in out.splitlines() if line.split()[:1] == ["all"])
    assert float(whole[2]) == 100 * errors["normal"][-1]["refused"]
    assert float(whole[-1]) == 100 * errors["normal"][-1]["within_2"]
    assert re.search(r"Errors of the normal force are [\d.e-]+ times the stated sigma\.", err)
    assert "Calibrate again" not in err
    assert "constant" not in err
    stiff = shutil.copytree(loads, tmp_path / "stiff")
    head, *rows = (line.split(",") for line in (loads / "loads.csv").read_text().splitlines())
    table = [head, *([image, name, str(6 * float(force))] for image, name, force in rows)]
    (stiff / "loads.csv").write_text("\n".join(map(",".join, table)))
    err = " ".join(works("force", "evaluate", stiff, "-c", own)[1].split())
    assert re.search(
        r"mean error of the normal force is [\d.]+ N, larger than that of a constant, [\d.]+ N", err
    )
    err = works("force", "calibrate", loads, "-c", own, "-o", tmp_path / "other.npz")[1]
    assert "Only two objects were pressed, so at least 30 % are stated. Press 1 more" in " ".join(err.split())
    assert said["normal"]["relative"] == 0.3
    assert f"normal: {said['normal']['loads']} loads" in err
    assert (tmp_path / "other.npz").is_file()


def test_what_is_refused_leaves_the_calibration(fails, loads, calibration_file, tmp_path):
    before = calibration_file.read_bytes()
    assert "gelform force calibrate" in fails("force", "evaluate", loads, "-c", calibration_file)
    light = shutil.copytree(loads, tmp_path / "grams")
    head, *rows = (line.split(",") for line in (loads / "loads.csv").read_text().splitlines())
    grams = [f"{image},{name},{float(force) * 1000 / 9.80665}" for image, name, force in rows]
    (light / "loads.csv").write_text("\n".join([",".join(head), *grams, ""]))
    assert "grams" in fails("force", "calibrate", light, "-c", calibration_file, "--overwrite")
    assert calibration_file.read_bytes() == before


def test_the_lag_is_stored_and_its_range_s_end_is_a_warning(
    works, run_json, loads, calibration_file, tmp_path
):
    """Loads that come four frames too early, which is beyond the range; evaluate takes the stored lag as it is."""
    rows = [line.split(",") for line in (loads / "loads.csv").read_text().splitlines()[1:]]
    names, force = [row[0] for row in rows], [float(row[2]) for row in rows]
    order = sorted(range(len(rows)), key=lambda k: force[k])
    ramp = [*order, *order[::-1]]
    film = shutil.copytree(loads, tmp_path / "film")
    lines = ["image,object,grasp,frame,force_n"]
    for frame, k in enumerate(ramp):
        early = force[ramp[min(frame + 4, len(ramp) - 1)]]
        lines.append(f"{names[k]},ball,0,{frame},{early}")
    (film / "loads.csv").write_text("\n".join([*lines, ""]))
    own = tmp_path / "cal.npz"
    err = works("force", "calibrate", film, "-c", calibration_file, "-o", own)[1]
    assert "a lag of -3 frames is at the end of the range" in err
    assert gelform.load_calibration(own).force.lag_frames == -3
    still = [f"{names[k]},ball,0,{frame},{force[k]}" for frame, k in enumerate(ramp)]
    (film / "loads.csv").write_text("\n".join([lines[0], *still, ""]))
    assert run_json("force", "evaluate", film, "-c", own)["lag_frames"] == -3
