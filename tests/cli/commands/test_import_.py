"""gelform import and gelform compare."""

import json

import numpy as np
import pytest

import gelform
from made.torch_file_writer import network_arrays, torch_file


@pytest.fixture
def network(tmp_path):
    return torch_file(tmp_path / "nnmodel.pth", network_arrays((5, 32, 32, 32, 2)))


@pytest.fixture
def imported(run, network, press_folder, tmp_path):
    path = tmp_path / "imported.npz"
    rest = press_folder / "background.png"
    code, _, err = run("import", network, "--from", "gs_sdk", "--background", rest, "-o", path)
    assert code == 0, err
    assert "results will be in pixels" in err
    return path


def images_of(press_folder):
    return sorted((press_folder / "images").iterdir())[:2]


def test_what_was_imported_reconstructs_in_pixels(run, run_json, imported, press_folder, tmp_path):
    image = images_of(press_folder)[0]
    rows = run_json("reconstruct", image, "-c", imported, "-o", tmp_path / "out", "--format", "npz,png")[
        "results"
    ]
    assert rows[0]["peak_px"] > 0
    assert "peak_mm" not in rows[0]
    with np.load(tmp_path / "out" / f"{image.stem}.npz") as file:
        assert "depth_px" in file.files
        assert "depth_mm" not in file.files
    assert run_json("info", tmp_path / "out" / f"{image.stem}.npz")["depth_px"][1] > 0
    assert run_json("info", imported)["mm_per_px"] is None
    code, out, err = run("reconstruct", image, "-c", imported, "-o", tmp_path / "again")
    assert code == 0
    assert "peak (px)" in out
    assert str(rows[0]["contact_px"]) in out.split()
    assert "depth_px, not depth_mm" in err


def test_with_a_scale_in_mm(run_json, network, press_folder, tmp_path):
    said = run_json(
        "import", network, "--from", "gs_sdk", "--background", press_folder / "background.png",
        "--mm-per-px", "0.1", "--name", "mine", "-o", tmp_path / "new" / "cal.npz",
    )  # fmt: skip
    assert (said["mm_per_px"], said["sensor_name"], said["color_model"]) == (0.1, "mine", "network")
    assert gelform.load_calibration(tmp_path / "new" / "cal.npz").digest == said["digest"]


def test_nothing_is_guessed(fails, network, press_folder, tmp_path):
    rest, out = press_folder / "background.png", tmp_path / "cal.npz"
    assert "--background" in fails("import", network, "--from", "gs_sdk", "-o", out, status=2)
    assert "gs_sdk, gsrobotics" in fails(
        "import", network, "--from", "x", "--background", rest, "-o", out, status=2
    )
    assert "zeros" in fails("import", network, "--from", "gsrobotics", "--background", rest, "-o", out)
    bad = tmp_path / "model.ckpt"
    bad.write_bytes(b"\x80\x02cdigit_depth\nMLP\n.")
    assert "could run code" in fails("import", bad, "--from", "gs_sdk", "--background", rest, "-o", out)
    assert not out.exists()
    out.write_bytes(b"")
    assert "already there" in fails("import", network, "--from", "gs_sdk", "--background", rest, "-o", out)


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
