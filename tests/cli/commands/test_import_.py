"""gelform import: other packages' calibrations, and what they lack."""

import numpy as np

import gelform


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
