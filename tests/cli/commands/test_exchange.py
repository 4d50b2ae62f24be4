"""gelform import and gelform export."""

import cv2
import numpy as np
import pytest

import gelform
from gelform.cli.commands import exchange
from gelform.exchange.exporters.surface import SURFACES
from gelform.exchange.exporters.taxim import RENDERERS
from gelform.result import load_result, save_result


def images_of(press_folder):
    return sorted((press_folder / "images").iterdir())[:2]


def test_what_was_imported_reconstructs_in_pixels(run, run_json, imported, press_folder, tmp_path):
    image = images_of(press_folder)[0]
    how = ("-c", imported, "-o", tmp_path / "out", "--format", "npz,png")
    (row,) = run_json("reconstruct", image, *how)["results"]
    assert row["peak_px"] > 0
    assert "peak_mm" not in row
    with np.load(tmp_path / "out" / f"{image.stem}.npz") as file:
        assert "depth_px" in file.files
        assert "depth_mm" not in file.files
    assert run_json("info", tmp_path / "out" / f"{image.stem}.npz")["depth_px"][1] > 0
    assert run_json("info", imported)["mm_per_px"] is None
    code, out, err = run("reconstruct", image, "-c", imported, "-o", tmp_path / "again")
    assert code == 0
    assert "peak (px)" in out
    assert str(row["contact_px"]) in out.split()
    assert "depth_px, not depth_mm" in err


def test_with_a_scale_in_mm(run_json, network, press_folder, tmp_path):
    said = run_json(
        "import", network, "--from", "gsrobotics-web", "--position", "zeros",
        "--background", press_folder / "background.png", "--mm-per-px", "0.1", "--name", "mine",
        "-o", tmp_path / "new" / "cal.npz",
    )  # fmt: skip
    assert (said["mm_per_px"], said["sensor_name"], said["color_model"]) == (0.1, "mine", "network")
    assert gelform.load_calibration(tmp_path / "new" / "cal.npz").digest == said["digest"]


def test_an_unusual_width_of_the_gel_is_noted(run, fails, network, press_folder, tmp_path):
    how = ("--from", "gsrobotics-web", "--position", "zeros", "--background", press_folder / "background.png")
    code, _, err = run("import", network, *how, "--mm-per-px", "0.025", "-o", tmp_path / "cal.npz")
    assert code == 0
    assert "this one would be 160 px of 0.025 mm: 4 mm" in " ".join(err.split())
    assert "160 px of 0.01 mm: 1.6 mm" in fails(
        "import", network, *how, "--mm-per-px", "0.01", "-o", tmp_path / "b.npz"
    )


def test_the_assumed_range_of_a_table_is_said_and_another_one_is_read(run, press_folder, tmp_path):
    """A table over +-256 that is read as one over +-90 reads slopes 2.8 times too large."""
    at = (np.arange(64) + 0.5) * 8 - 256
    _, _, red = np.meshgrid(at, at, at, indexing="ij")
    np.save(tmp_path / "table.npy", np.stack([0.004 * red, 0 * red], axis=-1))
    rest = press_folder / "background.png"
    how = ("import", tmp_path / "table.npy", "--from", "lut", "--background", rest, "--mm-per-px", "0.1268")
    assumed, given = tmp_path / "assumed.npz", tmp_path / "given.npz"
    code, _, err = run(*how, "-o", assumed)
    assert (code, "so -90 to 90 gray levels are assumed" in " ".join(err.split())) == (0, True)
    code, _, err = run(*how, "-o", given, "--range", "-256", "256")
    assert (code, "levels are assumed" in " ".join(err.split())) == (0, False)
    image = gelform.read_image(images_of(press_folder)[0])
    wrong, right = (
        gelform.Reconstructor(gelform.load_calibration(path)).from_image(image) for path in (assumed, given)
    )
    steep = (abs(right.observed_gradients[..., 0]) > 0.02) & (abs(right.observed_gradients[..., 0]) < 0.1)
    ratio = np.median(wrong.observed_gradients[steep, 0] / right.observed_gradients[steep, 0])
    assert ratio == pytest.approx(256 / 90, rel=0.02)


def test_the_crop_of_a_frame_is_said(run, network, tmp_path):
    y, x = np.mgrid[:480, :640]
    cv2.imwrite(
        str(tmp_path / "rest.png"), np.stack([x / 6 + 60, y / 6 + 60, 200 - x / 6], -1).astype(np.uint8)
    )
    how = ("--from", "gsrobotics-web", "--position", "zeros", "--background", tmp_path / "rest.png")
    code, _, err = run("import", network, *how, "--mm-per-px", "0.0634", "-o", tmp_path / "cal.npz")
    assert code == 0
    assert "Frames of 480x640 px are cropped and resized as gsrobotics-web does" in " ".join(err.split())
    assert gelform.load_calibration(tmp_path / "cal.npz").image_shape == (240, 320)


def test_nothing_is_guessed(fails, network, press_folder, tmp_path):
    rest, out = ("--background", press_folder / "background.png"), ("-o", tmp_path / "cal.npz")
    assert "--background" in fails("import", network, "--from", "gs_sdk", *out, status=2)
    assert "gs_sdk, gsrobotics" in fails("import", network, "--from", "x", *rest, *out, status=2)
    assert "zeros" in fails("import", network, "--from", "gsrobotics", *rest, *out)
    assert "No file" in fails("import", tmp_path / "nnmodel.pth", "--from", "gs_sdk", *rest, *out)
    assert not out[1].exists()
    out[1].write_bytes(b"")
    assert "already there" in fails("import", network, "--from", "gs_sdk", *rest, *out)


@pytest.fixture
def result_file(calibration_file, press_folder, tmp_path):
    image = gelform.read_image(press_folder / "images" / "0000.png")
    path = tmp_path / "ball.npz"
    save_result(gelform.Reconstructor(calibration_file)(image), path)
    return path


def test_what_is_offered_is_what_there_is():
    assert tuple(RENDERERS) == exchange.RENDERERS
    assert {f".{name}" for name in exchange.FILES} == set(SURFACES) - {".tif"}


@pytest.mark.slow
def test_a_calibration_for_a_renderer(run, calibration_file, tmp_path):
    assert run("export", calibration_file, "--to", "isaaclab", "-o", tmp_path / "mine")[0] == 0
    written = {path.name for path in (tmp_path / "mine").iterdir()}
    assert written == {"polycalib.npz", "bg.jpg", "real_bg.npy", "settings.txt"}


def test_a_result_as_a_surface(run, fails, calibration_file, result_file):
    assert run("export", result_file, "--to", "tiff")[0] == 0
    assert result_file.with_suffix(".tiff").is_file()
    assert load_result(result_file).mm_per_px
    assert "is there already" in fails("export", result_file, "--to", "tiff")
    assert run("export", result_file, "--to", "tiff", "--overwrite")[0] == 0
    assert "Expected a result to write for ply" in fails("export", calibration_file, "--to", "ply")
    assert "Expected a calibration to write for taxim" in fails("export", result_file, "--to", "taxim")
