"""Folders of presses with known loads: the table, the log, the gauge's lag, and real presses with their forces."""

import csv
from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration.loads import read_loads
from gelform.depth.force import calibrate_force, evaluate_force, force_from_result, sigma_ratio, why_no_normal
from gelform.errors import DataError
from gelform.simulate import Ball, simulate_press

RISE_MM = [0.12, 0.15, 0.19, 0.23, 0.28, 0.33, 0.39, 0.45, 0.5, 0.54, 0.58]
DEPTHS_MM = [*RISE_MM, *RISE_MM[::-1]]
K = 0.05
GAUGE_LAG = 2  # frames, of the wedge's gauge, as all its films tell


@pytest.fixture(scope="module")
def film(sensor, simulated, made_once):
    """A ball that presses and rises, one image a frame, and the gel at rest beside them."""
    return made_once("film_of_loads", lambda path: _filmed(path, sensor, simulated.background))


def _filmed(path, sensor, background):
    rng = np.random.default_rng(8)
    path.mkdir()
    cv2.imwrite(str(path / "rest.png"), background[..., ::-1].astype(np.uint8))
    for k, depth in enumerate(DEPTHS_MM):
        press = simulate_press(
            sensor, Ball(3.0), depth_mm=depth, center_mm=(0.5, -0.5), rng=rng, oversample=1
        )
        cv2.imwrite(str(path / f"{k}.png"), press.image[..., ::-1])
    return path


@pytest.fixture
def table(film, tmp_path):
    """Writes loads.csv, or another table, into a folder with links to the film."""
    for image in film.iterdir():
        (tmp_path / image.name).symlink_to(image)

    def write(columns, rows, name="loads.csv"):
        lines = [columns, *(",".join(map(str, row)) for row in rows)]
        (tmp_path / name).write_text("\n".join(lines) + "\n")
        return tmp_path

    return write


@pytest.fixture(scope="module")
def volumes(film, calibration):
    """The volume of each press, as it is read."""
    reconstruct = gelform.Reconstructor(calibration, gelform.read_image(film / "rest.png"))
    images = (gelform.read_image(film / f"{k}.png") for k in range(len(DEPTHS_MM)))
    return [gelform.touch_from_result(reconstruct(image)).volume_mm3 for image in images]


def test_single_presses(table, calibration, volumes):
    rows = [(f"{k}.png", "ball", K * v) for k, v in enumerate(volumes)]
    folder = table("image,object,force_n", rows)
    dim = (0.9 * cv2.imread(str(folder / "rest.png"))).astype(np.uint8)
    cv2.imwrite(str(folder / "background.png"), dim)
    found = read_loads(folder, calibration)
    assert [touch.volume_mm3 for touch in found.touches] == volumes, "rest.png comes before background.png"
    given = read_loads(folder, calibration, background=folder / "background.png")
    assert given.touches[-1].volume_mm3 != volumes[-1]
    assert found.lag_frames is None
    assert [load.normal_n for load in found.loads] == pytest.approx([row[2] for row in rows])
    model = calibrate_force(found.touches, found.loads)
    assert model.normal.weights[0][0] == pytest.approx(K)
    assert model.calibration_digest == calibration.digest


@pytest.mark.parametrize("lag", [-2, 0, 3])
def test_the_lag_of_a_gauge_is_found_and_removed(table, calibration, volumes, lag):
    force = np.interp(np.arange(len(volumes)) - lag, np.arange(len(volumes)), volumes) * K
    rows = [(f"{k}.png", "ball", 0, k, f) for k, f in enumerate(force)]
    found = read_loads(table("image,object,grasp,frame,force_n", rows), calibration)
    assert found.lag_frames == lag
    assert len(found.loads) == len(volumes) - abs(lag)
    assert {load.grasp for load in found.loads} == {"0"}
    read = np.array([touch.volume_mm3 for touch in found.touches])
    assert [touch.falling for touch in found.touches] == list(read < 0.9 * np.maximum.accumulate(read))
    assert np.any(read < 0.9 * read.max())
    model = calibrate_force(found.touches, found.loads)
    assert model.normal.weights[0][0] == pytest.approx(K)


def test_a_lag_that_is_known_is_not_fitted_to_the_loads(table, calibration, volumes):
    """Given for all recordings, or stated by the table for one; loads fitted to any lag would look right."""
    force = np.interp(np.arange(len(volumes)) - 3, np.arange(len(volumes)), volumes) * K
    rows = [(f"{k}.png", "ball", 0, k, f) for k, f in enumerate(force)]
    folder = table("image,object,grasp,frame,force_n", rows)
    right, wrong = (read_loads(folder, calibration, lag_frames=lag) for lag in (3, -3))
    assert (right.lag_frames, wrong.lag_frames) == (3, -3)
    model = calibrate_force(right.touches, right.loads)
    own, others = (
        evaluate_force(model, one.touches, one.loads)["normal"][-1]["mae"] for one in (right, wrong)
    )
    assert own < 0.01 < others
    assert sigma_ratio(model, wrong.touches, wrong.loads) > 3 * sigma_ratio(model, right.touches, right.loads)
    stated = table(
        "image,object,grasp,frame,force_n,lag_frames", [(*row, 3 if row[3] == 0 else "") for row in rows]
    )
    assert read_loads(stated, calibration, lag_frames=-3).lag_frames == 3
    for lags, said in (
        ((3, 2), r"one whole lag_frames for each recording, got \[2\.0, 3\.0\]"),
        ((2.5, 2.5), "whole"),
    ):
        folder = table("image,object,grasp,frame,force_n,lag_frames", [(*r, lags[r[3] % 2]) for r in rows])
        with pytest.raises(DataError, match=said):
            read_loads(folder, calibration)


def test_a_short_film_tells_its_lag_though_it_has_too_few_frames_at_the_largest(table, calibration, volumes):
    rise = volumes[: len(RISE_MM)]
    force = np.interp(np.arange(len(rise)) - 2, np.arange(len(rise)), rise) * K
    rows = [(f"{k}.png", "ball", 0, k, f) for k, f in enumerate(force)]
    assert read_loads(table("image,object,grasp,frame,force_n", rows), calibration).lag_frames == 2


def test_a_film_of_one_load_tells_no_lag(table, calibration):
    rows = [(f"{k}.png", "ball", 0, k, 1.5) for k in range(11)]
    found = read_loads(table("image,object,grasp,frame,force_n", rows), calibration)
    assert found.lag_frames is None
    assert [load.normal_n for load in found.loads] == [1.5] * 11


def test_a_log_with_times(table, calibration, volumes):
    seconds = 0.1 * np.arange(len(volumes))
    log = [(t, K * np.interp(t - 0.2, seconds, volumes)) for t in np.arange(0, 3.5, 0.01)]
    table("time_s,force_n", log, "log.csv")
    rows = [(f"{k}.png", "ball", t) for k, t in enumerate(seconds)]
    found = read_loads(table("image,object,time_s", rows), calibration)
    assert found.lag_frames == 2
    assert [load.normal_n for load in found.loads] == pytest.approx(K * np.array(volumes), rel=0.02)


def test_sideways_loads_and_empty_cells(table, calibration):
    rows = [
        ("1.png", "ball", "", 0.5, -0.2, 3),
        ("2.png", "ball", 1.5, "", "", ""),
        ("3.png", "ball", "", "", "", ""),
    ]
    found = read_loads(table("image,object,force_n,force_x_n,force_y_n,torque_n_mm", rows), calibration)
    assert [(load.normal_n, load.shear_n, load.torsion_n_mm) for load in found.loads] == [
        (None, (0.5, -0.2), 3), (1.5, None, None),
    ]  # fmt: skip
    assert found.names == ["1.png", "2.png"]


BAD = {
    "no table": (None, "loads.csv"),
    "no rows": (("image,object,force_n", []), "Expected loads"),
    "no column": (("image,object,weight", [("1.png", "ball", 3)]), "force_n"),
    "no number": (("image,object,force_n", [("1.png", "ball", "much")]), "a number"),
    "no image": (("image,object,force_n", [("gone.png", "ball", 3)]), "gone.png"),
    "another size": (("image,object,force_n", [("odd.png", "ball", 3)]), "odd"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_folders_get_a_sentence(table, calibration, tmp_path, name):
    given, said = BAD[name]
    cv2.imwrite(str(tmp_path / "odd.png"), np.full((50, 60, 3), 90, np.uint8))
    if given is not None:
        table(*given)
    with pytest.raises(DataError, match=said):
        read_loads(tmp_path, calibration)


def test_a_calibration_keeps_its_forces_and_its_digest(table, calibration, volumes, film, tmp_path):
    rows = [(f"{k}.png", "ball", K * v) for k, v in enumerate(volumes)]
    found = read_loads(table("image,object,force_n", rows), calibration)
    forceful = replace(calibration, force=calibrate_force(found.touches, found.loads))
    assert forceful.digest == calibration.digest
    forceful.save(tmp_path / "f.npz")
    loaded = gelform.load_calibration(tmp_path / "f.npz")
    assert loaded.force.to_dict() == forceful.force.to_dict()
    image = gelform.read_image(film / "6.png")
    result = gelform.Reconstructor(loaded, gelform.read_image(film / "rest.png"))(image)
    assert result.force.normal_n == pytest.approx(K * volumes[6], rel=1e-3)
    gelform.save_result(result, tmp_path / "r.npz")
    again = gelform.load_result(tmp_path / "r.npz")
    assert force_from_result(again, loaded.force) == result.force
    assert "no loads" in again.force.normal_reason


@pytest.mark.slow
def test_real_objects_of_which_one_is_left_out(data, tmp_path):
    """The wedge: hard objects are told within a quarter, and soft ones refused."""
    source = data / "force-wedge"
    with (source / "loads.csv").open() as file:
        rows = list(csv.DictReader(file))
    (tmp_path / "images").symlink_to(source / "images")
    (tmp_path / "background").mkdir()
    for k in range(3):
        (tmp_path / "background" / f"{k}.png").symlink_to(source / f"images/golf_ball-{k}/rest.png")
    golf = [row["image"] for row in rows if row["object"] == "golf_ball" and float(row["force_n"]) > 2][::2]
    (tmp_path / "presses.csv").write_text(
        "image,ball_diameter_mm\n" + "".join(f"{image},42.67\n" for image in golf)
    )
    (tmp_path / "sensor.toml").write_text((source / "sensor.toml").read_text())
    calibration = gelform.calibrate(gelform.read_presses(tmp_path), start=None)
    kept = [row for row in rows if row["grasp"] == "1"]
    text = [",".join(rows[0]), *(",".join(row.values()) for row in kept)]
    (tmp_path / "loads.csv").write_text("\n".join(text) + "\n")
    # five short films tell it no better
    assert abs(read_loads(tmp_path, calibration).lag_frames - GAUGE_LAG) <= 2
    found = read_loads(tmp_path, calibration, lag_frames=GAUGE_LAG)
    soft = [
        why_no_normal(touch) != ""
        for touch, load in zip(found.touches, found.loads)
        if load.normal_n > 10 and load.object not in ("golf_ball", "rigid_strawberry")
    ]
    assert np.mean(soft) >= 0.9
    own = [i for i, load in enumerate(found.loads) if load.object == "golf_ball"]
    others = [i for i in range(len(found.loads)) if i not in own]
    model = calibrate_force([found.touches[i] for i in others], [found.loads[i] for i in others])
    row = evaluate_force(model, [found.touches[i] for i in own], [found.loads[i] for i in own])["normal"][-1]
    assert row["median"] < 0.3
    assert row["within_2"] > 0.8
