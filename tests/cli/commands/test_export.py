"""gelform export: the right file for each kind, and a word where they do not go together."""

import pytest

import gelform
from gelform.cli.commands import export
from gelform.exporters.surface import SURFACES
from gelform.exporters.taxim import RENDERERS
from gelform.reconstruction import load_result, save_result


@pytest.fixture
def result_file(calibration_file, press_folder, tmp_path):
    image = gelform.read_image(press_folder / "images" / "0000.png")
    path = tmp_path / "ball.npz"
    save_result(gelform.Reconstructor(calibration_file)(image), path)
    return path


def test_what_is_offered_is_what_there_is():
    assert tuple(RENDERERS) == export.RENDERERS
    assert {f".{name}" for name in export.FILES} == set(SURFACES) - {".tif"}


@pytest.mark.slow
def test_a_calibration_for_a_renderer(run, calibration_file, tmp_path):
    assert run("export", calibration_file, "--to", "isaaclab", "-o", tmp_path / "mine")[0] == 0
    assert {path.name for path in (tmp_path / "mine").iterdir()} == {
        "polycalib.npz",
        "bg.jpg",
        "real_bg.npy",
        "settings.txt",
    }


def test_a_result_as_a_surface(run, fails, result_file):
    assert run("export", result_file, "--to", "tiff")[0] == 0
    assert result_file.with_suffix(".tiff").is_file()
    assert load_result(result_file).mm_per_px
    assert "is there already" in fails("export", result_file, "--to", "tiff")
    assert run("export", result_file, "--to", "tiff", "--overwrite")[0] == 0


def test_what_does_not_go_together_is_said(fails, calibration_file, result_file, tmp_path):
    assert "Expected a result to write for ply" in fails("export", calibration_file, "--to", "ply")
    assert "Expected a calibration to write for taxim" in fails("export", result_file, "--to", "taxim")
