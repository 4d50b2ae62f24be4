"""A press folder is written whole or not at all."""

import csv
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform.exporters.press_folder import save_press_folder, save_simulated_presses
from gelform.simulate import LAYOUTS, simulate_ball_presses

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SENSOR = replace(LAYOUTS["three-edges"], shape=(48, 64), mm_per_px=0.3, name='a "quoted" name')
ARGUMENTS = {
    "background": np.zeros((8, 9, 3), np.uint8),
    "images": [np.zeros((8, 9, 3), np.uint8)],
    "ball_diameters_mm": [4.0],
    "mm_per_px": 0.1,
    "name": "x",
}


@pytest.fixture(scope="module")
def simulated():
    return simulate_ball_presses(
        SENSOR, ball_diameters_mm=[6.31], count=3, rng=np.random.default_rng(0), oversample=1
    )


def test_a_center_is_a_point(tmp_path):
    image = np.full((8, 9, 3), 90, np.uint8)
    with pytest.raises(TypeError, match="each of centers_px as a list, got int"):
        save_press_folder(
            tmp_path / "presses", background=image, images=[image], ball_diameters_mm=[5.0], mm_per_px=0.1, name="x",
            centers_px=[3],
        )  # fmt: skip


def test_what_is_written_is_what_was_simulated(tmp_path, simulated):
    folder = save_simulated_presses(tmp_path / "deep" / "presses", simulated)
    assert sorted(p.name for p in folder.iterdir()) == [
        "background.png",
        "images",
        "presses.csv",
        "sensor.toml",
        "truth",
    ]
    rows = list(csv.DictReader((folder / "presses.csv").open()))
    assert len(rows) == 3
    for row, press in zip(rows, simulated.presses):
        image = cv2.imread(str(folder / row["image"]))[..., ::-1]
        np.testing.assert_array_equal(image, press.image)
        assert float(row["ball_diameter_mm"]) == 6.31
        assert float(row["center_x_px"]) == pytest.approx(press.center_px[0], abs=1e-4)
        assert float(row["center_y_px"]) == pytest.approx(press.center_px[1], abs=1e-4)
        assert float(row["contact_radius_px"]) == pytest.approx(press.contact_radius_px, abs=1e-4)
    truth = np.load(folder / "truth" / "0002.npz")
    np.testing.assert_array_equal(truth["depth_mm"], simulated.presses[2].depth_mm.astype(np.float32))
    np.testing.assert_array_equal(truth["contact"], simulated.presses[2].contact)
    sensor = tomllib.loads((folder / "sensor.toml").read_text())
    assert sensor == {"name": SENSOR.name, "mm_per_px": 0.3}
    np.testing.assert_array_equal(cv2.imread(str(folder / "background.png"))[..., ::-1], simulated.background)


def test_nothing_is_left_where_writing_fails_halfway(tmp_path):
    wrong_size = [*ARGUMENTS["images"], np.zeros((3, 3, 3), np.uint8)]
    with pytest.raises(ValueError, match=r"0001\.png"):
        save_press_folder(
            tmp_path / "out", **ARGUMENTS | {"images": wrong_size, "ball_diameters_mm": [4.0, 4.0]}
        )
    assert list(tmp_path.iterdir()) == []


def test_bad_lists_are_refused(tmp_path):
    for change, message in [
        ({"images": []}, "at least one image"),
        ({"ball_diameters_mm": [4.0, 5.0]}, "1 ball_diameters_mm"),
        ({"ball_diameters_mm": [0.0]}, "ball_diameter_mm > 0"),
        ({"mm_per_px": 0}, "mm_per_px > 0"),
        ({"truths": []}, "1 truths"),
    ]:
        with pytest.raises(ValueError, match=message):
            save_press_folder(tmp_path / "out", **ARGUMENTS | change)
        assert list(tmp_path.iterdir()) == []
