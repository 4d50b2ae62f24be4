"""gelform simulate and gelform design: their outputs; gelform demo, with a smaller sensor and fewer presses."""

import csv
import json

import numpy as np
import pytest

from gelform.calibration.presses.folder import read_presses
from gelform.cli.commands import simulate as commands
from gelform.exchange.plots import save_picture
from gelform.result import load_result
from gelform.result.metrics import angle_deg
from gelform.sensors.files import read_image
from gelform.simulate import LAYOUTS


@pytest.fixture(autouse=True)
def small_layout(monkeypatch):
    from tests.cli.conftest import SMALL

    monkeypatch.setitem(LAYOUTS, "small", SMALL)


def test_presses_with_their_truth(run_json, tmp_path):
    arguments = ("simulate", "--sensor", "small", "--count", "3", "--ball-diameter-mm", "5", "--seed", "4")
    assert run_json(*arguments, "-o", tmp_path / "a")["presses"] == 3
    presses = read_presses(tmp_path / "a")
    assert [press.ball_diameter_mm for press in presses.presses] == [5, 5, 5]
    assert all(press.label is not None for press in presses.presses)
    with np.load(tmp_path / "a" / "truth" / "0001.npz") as truth:
        assert truth["depth_mm"].shape == presses.image_shape
    run_json(*arguments, "-o", tmp_path / "b")
    for path in (tmp_path / "a").rglob("*.png"):
        assert path.read_bytes() == (tmp_path / "b" / path.relative_to(tmp_path / "a")).read_bytes()


def test_loads_are_those_of_the_true_volumes_and_calibrate_forces(works, tmp_path, calibration_file):
    out = tmp_path / "loads"
    works("simulate", "-o", out, "--sensor", "small", "--count", "8", "--loads", "--seed", "3")
    with (out / "loads.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["object"] for row in rows} == {"ball 6 mm", "ball 9 mm"}
    for row in rows:
        with np.load(out / row["image"].replace("images", "truth").replace("png", "npz")) as truth:
            volume_mm3 = truth["depth_mm"][truth["contact"]].sum() * 0.1268**2
        assert float(row["force_n"]) == pytest.approx(0.1 * volume_mm3, rel=1e-4)
    with (out / "presses.csv").open(newline="") as file:
        assert "force_n" not in next(csv.DictReader(file))
    works("force", "calibrate", out, "-c", calibration_file, "-o", tmp_path / "force.npz")


def test_a_press_that_moves_is_tracked(works, run_json, tmp_path, calibration_file):
    out, table = tmp_path / "out", tmp_path / "track.csv"
    arguments = ("simulate", "--sensor", "small", "--count", "1", "--depth-mm", "0.4")
    assert run_json(*arguments, "--as", "video", "-o", out)["as"] == ["video"]
    works("track", out / "moving/moving.avi", "-c", calibration_file, "-o", table)
    with table.open(newline="") as file, (out / "moving/motion.csv").open(newline="") as truth:
        pairs = list(zip(csv.DictReader(file), csv.DictReader(truth), strict=True))
    found = [(row, true) for row, true in pairs if row["state"] != "lost"]
    assert [true["index"] for _, true in found] == [str(k) for k in range(6, 31)]
    for row, true in found:
        assert float(row["x_mm"]) == pytest.approx(float(true["x_mm"]), abs=0.02)
        assert float(row["y_mm"]) == pytest.approx(float(true["y_mm"]), abs=0.02)


def test_all_truth_of_a_height_map_is_written(works, tmp_path):
    block = np.zeros((60, 60))
    block[20:40, 20:40] = 0.5
    np.save(tmp_path / "block.npy", block)
    face = ("--height-map", tmp_path / "block.npy", "--height-map-mm-per-px", "0.1", "--depth-mm", "0.3")
    works("simulate", "-o", tmp_path / "out", "--sensor", "small", *face, "--seed", "7")
    with np.load(tmp_path / "out" / "truth.npz") as truth:
        assert truth["contact"].sum() * 0.1268**2 == pytest.approx(4, rel=0.25)
        assert {"depth_mm", "gradients", "albedo", "shadowed", "saturated", "markers_px"} <= set(truth.files)
        assert json.loads(str(truth["meta"]))["seed"] == 7
        assert truth["mm_per_px"] == 0.1268
        assert truth["depth_mm"].max() == pytest.approx(0.3, abs=0.02)
    assert (tmp_path / "out" / "image.png").is_file()
    said = json.loads((tmp_path / "out" / "parameters.json").read_text())
    assert said["seed"] == 7
    assert said["sensor"]["shape"] == [120, 160]


def test_a_sensor_of_ones_own(run_json, tmp_path):
    (tmp_path / "mine.toml").write_text('base = "digit"\nshape = [40, 30]\nmm_per_px = 0.4\n')
    how = ("--sensor", tmp_path / "mine.toml", "--count", "2", "-o", tmp_path / "one")
    assert run_json("simulate", *how)["sensor"] == "digit"
    assert read_presses(tmp_path / "one").image_shape == (40, 30)


@pytest.mark.slow
def test_presses_like_a_calibration(run_json, calibration_file, tmp_path):
    arguments = ("simulate", "--like", calibration_file, "--count", "2")
    said = run_json(*arguments, "-o", tmp_path / "twin")
    assert said["sensor"] == f"like {calibration_file}"
    assert len(read_presses(tmp_path / "twin").presses) == 2
    run_json(*arguments, "-o", tmp_path / "again", "--workers", "2")
    for path in (p for p in (tmp_path / "twin").rglob("*") if p.is_file()):
        assert path.read_bytes() == (tmp_path / "again" / path.relative_to(tmp_path / "twin")).read_bytes()
    assert json.loads((tmp_path / "twin/parameters.json").read_text())["like"]
    run_json(*arguments, "-o", tmp_path / "other", "--seed", "5")
    flat = [read_image(tmp_path / name / "images/0001.png")[:20, :20] for name in ("twin", "other")]
    assert np.any(flat[0] != flat[1])


def test_a_height_map_like_a_calibration(works, calibration_file, tmp_path):
    np.save(tmp_path / "roof.npy", -0.3 * np.abs(np.mgrid[-2:2:41j, -2:2:41j][1]))
    face = ("--height-map", tmp_path / "roof.npy", "--height-map-mm-per-px", "0.1", "--depth-mm", "0.4")
    works("simulate", "-o", tmp_path / "out", *face, "--like", calibration_file)
    image, rest = (read_image(tmp_path / "out" / f"{n}.png").astype(float) for n in ("image", "background"))
    with np.load(tmp_path / "out" / "truth.npz") as truth:
        pressed = truth["depth_mm"] > 0.2
    assert np.abs(image - rest)[pressed].mean() > 5 * np.abs(image - rest)[:8].mean()


def test_presses_like_taxims_tables(run_json, tmp_path):
    table = np.zeros((90, 90, 6))
    table[..., 5] = np.arange(90)[:, None]
    np.savez(tmp_path / "polycalib.npz", bins=90, grad_r=table, grad_g=table, grad_b=table)
    arguments = ("simulate", "--like", tmp_path / "polycalib.npz", "--count", "1")
    run_json(*arguments, "--mm-per-px", "0.0634", "-o", tmp_path / "gray")
    presses = read_presses(tmp_path / "gray")
    assert presses.image_shape == (240, 320)
    assert np.all(presses.background == 110)
    assert presses.presses[0].image.max() > 125
    save_picture(tmp_path / "rest.png", np.full((60, 80, 3), 90, np.uint8))
    rest = ("--background", tmp_path / "rest.png", "--mm-per-px", "0.25")
    run_json(*arguments, *rest, "-o", tmp_path / "own")
    assert np.all(read_presses(tmp_path / "own").background == 90)


@pytest.mark.slow
def test_the_designs_are_compared(run_json, tmp_path, monkeypatch):
    from gelform.calibration import design

    pytest.importorskip("matplotlib")
    monkeypatch.setattr(design.compare_designs, "__defaults__", (design.VARIATIONS[:1],))
    (tmp_path / "mine.toml").write_text('base = "ring-120"\nshape = [120, 160]\nmm_per_px = 0.1268\n')
    said = run_json("design", tmp_path / "mine.toml", "--presses", "8", "-o", tmp_path / "study.png")
    assert [row["design"] for row in said["designs"]] == ["as given"]
    assert 0 < said["designs"][0]["depth_rmse_um"] < 500
    assert (tmp_path / "study.png").stat().st_size > 10_000


@pytest.mark.slow
def test_the_whole_path_and_its_errors(run_json, fails, monkeypatch, tmp_path):
    pytest.importorskip("matplotlib", reason="pictures need the extra 'plots'")
    monkeypatch.setattr(commands, "LAYOUT", "small")
    monkeypatch.setattr(commands, "PRESSES", 8)
    said = run_json("demo", "-o", tmp_path / "d")
    names = {path.relative_to(tmp_path / "d").as_posix() for path in (tmp_path / "d").rglob("*.*")}
    assert {"ball.png", "coin.png", "screw.png", "border.png", "report/report.html"} <= names
    assert json.loads((tmp_path / "d" / "errors.json").read_text()) == said["errors"]
    assert abs(said["errors"]["ball"]["peak_ratio"] - 1) < 0.15
    ball = said["errors"]["ball"]
    assert ball["rmse_um"] < 40
    press, found = dict(commands._objects(LAYOUTS["small"]))["ball"], load_result(tmp_path / "d" / "ball.npz")
    off_um = 1e3 * (found.depth_mm - press.depth_mm)[press.contact]
    assert ball["rmse_contact_um"] == pytest.approx(np.sqrt(np.mean(off_um**2)), rel=1e-5)
    degrees = angle_deg(found.gradients, press.gradients)[press.contact].mean()
    assert ball["normal_contact_deg"] == pytest.approx(degrees, rel=1e-5)
    assert load_result(tmp_path / "d" / "border.npz").contact.any()
    assert "holds something" in fails("demo", "-o", tmp_path / "d")
