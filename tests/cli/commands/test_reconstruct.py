"""gelform reconstruct: images of one name give as many results, and nothing is half done."""

import json
import shutil

import numpy as np
import pytest

from gelform.plots.canvas import save_picture
from gelform.reconstruction import load_result
from gelform.sensors.files import read_image

pytest.importorskip("matplotlib", reason="pictures need the extra 'plots'")


@pytest.fixture
def images(press_folder, tmp_path):
    """23 images of one name, each in its own folder."""
    paths = []
    for k in range(23):
        paths.append(tmp_path / "in" / str(k) / "gelsight.png")
        paths[-1].parent.mkdir(parents=True)
        shutil.copy(press_folder / "images" / f"{k % 10:04d}.png", paths[-1])
    return paths


def test_23_images_of_one_name_give_23_results(run, images, calibration_file, press_folder, tmp_path):
    code, out, err = run("reconstruct", *images, "-c", calibration_file, "-o", tmp_path / "out")
    assert code == 0, err
    assert sorted(
        path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.npz")
    ) == sorted(f"{k}/gelsight.npz" for k in range(23))
    assert out.count("gelsight.npz") == 23
    result = load_result(tmp_path / "out" / "0" / "gelsight.npz")
    truth = np.load(press_folder / "truth" / "0000.npz")
    assert np.corrcoef(result.depth_mm.ravel(), truth["depth_mm"].ravel())[0, 1] > 0.97


def test_a_lone_image_keeps_its_name_and_gets_a_picture(run_json, calibration_file, press_folder, tmp_path):
    said = run_json(
        "reconstruct",
        press_folder / "images" / "0003.png",
        "-c",
        calibration_file,
        "-o",
        tmp_path,
        "--format",
        "npz,png",
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0003.npz", "0003.png"]
    assert read_image(tmp_path / "0003.png").shape[1] > 1000
    (row,) = said["results"]
    assert row["outputs"] == [str(tmp_path / "0003.npz"), str(tmp_path / "0003.png")]
    assert np.isclose(row["peak_mm"], load_result(tmp_path / "0003.npz").peak_mm)


def test_another_background_changes_the_result(run_json, calibration_file, press_folder, tmp_path):
    image = press_folder / "images" / "0000.png"
    rest = read_image(press_folder / "background.png").astype(float)
    save_picture(tmp_path / "rest.png", np.clip(rest * 1.15, 0, 255).astype(np.uint8))
    own = run_json("reconstruct", image, "-c", calibration_file, "-o", tmp_path / "a")["results"][0]
    other = run_json(
        "reconstruct",
        image,
        "-c",
        calibration_file,
        "-o",
        tmp_path / "b",
        "--background",
        tmp_path / "rest.png",
    )["results"][0]
    assert own["findings"] == []
    assert [finding["name"] for finding in other["findings"]] == ["background_ratio"] * len(other["findings"])
    assert len(other["findings"]) >= 1


def test_results_stay_unless_overwritten(run, fails, calibration_file, press_folder, tmp_path):
    image = press_folder / "images" / "0000.png"
    (tmp_path / "0000.npz").write_text("mine")
    arguments = ("reconstruct", image, "-c", calibration_file, "-o", tmp_path)
    assert "already there" in fails(*arguments)
    assert (tmp_path / "0000.npz").read_text() == "mine"
    assert run(*arguments, "--overwrite", "--quiet") == (0, "", "")
    assert load_result(tmp_path / "0000.npz")


def test_a_picture_never_replaces_its_image(fails, calibration_file, press_folder, tmp_path):
    image = tmp_path / "frame.png"
    shutil.copy(press_folder / "images" / "0000.png", image)
    before = image.read_bytes()
    said = fails(
        "reconstruct", image, "-c", calibration_file, "-o", tmp_path, "--format", "png", "--overwrite"
    )
    assert "would replace an input" in said
    assert image.read_bytes() == before


def test_mistakes_are_one_line(fails, calibration_file, press_folder, tmp_path):
    image = press_folder / "images" / "0000.png"
    out = tmp_path / "out"
    (tmp_path / "text.png").write_text("hello")
    (tmp_path / "file").touch()
    save_picture(tmp_path / "small.png", np.zeros((10, 12, 3), dtype=np.uint8))
    save_picture(
        tmp_path / "other.png", np.random.default_rng(0).integers(0, 256, (120, 160, 3), dtype=np.uint8)
    )
    for arguments, text in (
        ((tmp_path / "missing.png", "-c", calibration_file, "-o", out), "No file"),
        ((tmp_path / "text.png", "-c", calibration_file, "-o", out), "no image that can be read"),
        (
            (tmp_path / "small.png", "-c", calibration_file, "-o", out),
            "small.png: Expected image of 120x160 px",
        ),
        (
            (tmp_path / "other.png", "-c", calibration_file, "-o", out),
            "other.png: The background is not of this image",
        ),
        ((image, "-c", tmp_path / "missing.npz", "-o", out), "No file"),
        ((image, "-c", image, "-o", out), "no gelform calibration at all"),
        ((image, "-c", calibration_file, "-o", tmp_path / "file"), "got the file"),
        ((image, image, "-c", calibration_file, "-o", out), "given twice"),
    ):
        assert text in fails("reconstruct", *arguments)
    assert not list(out.rglob("*.npz"))


def test_one_bad_image_does_not_stop_the_others(run, run_json, calibration_file, press_folder, tmp_path):
    good = [press_folder / "images" / f"000{k}.png" for k in range(3)]
    (tmp_path / "bad.png").write_text("no image")
    arguments = ("reconstruct", good[0], tmp_path / "bad.png", *good[1:], "-c", calibration_file)
    code, out, err = run(*arguments, "-o", tmp_path / "out")
    assert code == 1
    assert err.startswith(f"gelform: error: {tmp_path / 'bad.png'} is ")
    assert "3 of 4 images done, 0 skipped, 1 not possible." in err
    assert sum(1 for _ in (tmp_path / "out").rglob("*.npz")) == 3
    assert out.count(".npz") == 3
    code, out, _ = run(*arguments, "-o", tmp_path / "again", "--json")
    said = json.loads(out)
    assert (code, len(said["results"])) == (1, 3)
    assert [one["image"] for one in said["failed"]] == [str(tmp_path / "bad.png")]


def test_it_goes_on_where_it_was(run, calibration_file, press_folder, tmp_path):
    images = [press_folder / "images" / f"000{k}.png" for k in range(3)]
    out = tmp_path / "out"
    assert run("reconstruct", *images, "-c", calibration_file, "-o", out, "-q")[0] == 0
    (out / "0001.npz").unlink()
    (out / "0002.npz").write_text("mine")
    code, said, err = run("reconstruct", *images, "-c", calibration_file, "-o", out, "--skip-existing")
    assert code == 0
    assert "1 of 3 images done, 2 skipped, 0 not possible." in err
    assert said.count(".npz") == 1
    assert load_result(out / "0001.npz")
    assert (out / "0002.npz").read_text() == "mine"


def test_strict_fails_on_a_warning(run, calibration_file, press_folder, tmp_path):
    rest = read_image(press_folder / "background.png").astype(float)
    save_picture(tmp_path / "rest.png", np.clip(rest * 1.15, 0, 255).astype(np.uint8))
    arguments = ("reconstruct", press_folder / "images" / "0000.png", "-c", calibration_file)
    assert run(*arguments, "-o", tmp_path / "a", "--strict")[0] == 0
    warned = (*arguments, "--background", tmp_path / "rest.png")
    assert run(*warned, "-o", tmp_path / "b")[0] == 0
    assert run(*warned, "-o", tmp_path / "c", "--strict")[0] == 1
    assert load_result(tmp_path / "c" / "0000.npz")


def test_unknown_formats_and_solvers_are_usage(fails, calibration_file, press_folder, tmp_path):
    image = press_folder / "images" / "0000.png"
    said = fails(
        "reconstruct", image, "-c", calibration_file, "-o", tmp_path, "--format", "npz,obj", status=2
    )
    assert "npz, png" in said
    assert "auto, dct" in fails(
        "reconstruct", image, "-c", calibration_file, "-o", tmp_path, "--solver", "x", status=2
    )


def test_a_full_disk_leaves_nothing_half_written(fails, calibration_file, press_folder, tmp_path):
    resource = pytest.importorskip("resource", reason="a limit on file sizes stands for a full disk")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 15, hard))
    try:
        said = fails(
            "reconstruct", press_folder / "images" / "0000.png", "-c", calibration_file, "-o", tmp_path
        )
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert "Cannot write" in said
    assert list(tmp_path.iterdir()) == []
