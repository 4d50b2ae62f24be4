"""gelform explain: shares that add up, faults by name, a picture for each image."""

import cv2
import pytest

import gelform


@pytest.fixture
def spotted(press_folder, tmp_path):
    """A press with a burnt-out spot."""
    image = cv2.imread(str(press_folder / "images" / "0001.png"))
    image[20:40, 30:55] = 255
    path = tmp_path / "spotted.png"
    cv2.imwrite(str(path), image)
    return path


@pytest.mark.slow
def test_explain_names_causes_and_draws_them(
    run, run_json, calibration_file, press_folder, spotted, tmp_path
):
    pytest.importorskip("matplotlib", reason="matplotlib, the extra `plots`, is not installed")
    clean = press_folder / "images" / "0001.png"
    rows = run_json("explain", clean, spotted, "-c", calibration_file, "-o", tmp_path / "why")["images"]
    assert [row["image"] for row in rows] == [str(clean), str(spotted)]
    for row in rows:
        assert sum(row["variance_shares"].values()) == pytest.approx(1)
        assert gelform.read_image(row["picture"]).shape[2] == 3
    found = [{finding["name"]: finding["figure"] for finding in row["findings"]} for row in rows]
    assert "saturated" not in found[0]
    assert found[1]["saturated"] == pytest.approx(20 * 25 / (120 * 160), rel=0.6)
    code, out, said = run("explain", spotted, "-c", calibration_file)
    assert code == 0
    assert "saturated (%)" in out
    assert "of the frame is at the camera's upper end. Lower exposure" in said


def test_an_image_of_another_sensor_is_refused(fails, calibration_file, tmp_path):
    import numpy as np

    cv2.imwrite(str(tmp_path / "other.png"), np.full((30, 40, 3), 90, np.uint8))
    assert "other.png" in fails("explain", tmp_path / "other.png", "-c", calibration_file)
