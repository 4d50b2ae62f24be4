"""gelform compare: two calibrations on the same images, in one unit, with a picture."""

import json

import pytest

import gelform


def images_of(press_folder):
    return [press_folder / "images" / f"000{k}.png" for k in (1, 4)]


@pytest.mark.slow
def test_compare_writes_a_picture_for_each_image(
    run, run_json, imported, calibration_file, press_folder, tmp_path
):
    pytest.importorskip("matplotlib", reason="matplotlib, the extra `plots`, is not installed")
    images, folder = images_of(press_folder), tmp_path / "side"
    said = run_json("compare", *images, "-c", calibration_file, "-c", imported, "-o", folder)
    assert [row["image"] for row in said["images"]] == [str(image) for image in images]
    for image, row in zip(images, said["images"]):
        assert gelform.read_image(folder / f"{image.stem}.png").shape[2] == 3
        assert row["unit"] == "px"
        assert row["peak_a"] > 0
    code, out, _ = run("compare", images[0], "-c", calibration_file, "-c", calibration_file)
    assert code == 0
    assert "peak A (mm)" in out


def test_a_calibration_agrees_with_itself(run_json, calibration_file, press_folder):
    row = run_json("compare", images_of(press_folder)[0], "-c", calibration_file, "-c", calibration_file)[
        "images"
    ][0]
    assert (row["unit"], row["difference_rms"], row["angle_deg"]) == ("mm", 0, 0)
    assert row["peak_a"] == row["peak_b"] > 0
    json.dumps(row)


def test_compare_wants_two(fails, calibration_file, press_folder, tmp_path):
    image = images_of(press_folder)[0]
    assert "expected two, got 1" in fails("compare", image, "-c", calibration_file, status=2)
    assert "No file" in fails("compare", image, "-c", calibration_file, "-c", tmp_path / "none.npz")
