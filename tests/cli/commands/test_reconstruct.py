"""gelform reconstruct: images with the same name give as many results, and no result is partial."""

import csv
import json
import shutil
import webbrowser

import cv2
import numpy as np
import pytest

import gelform
from gelform.exchange.plots import save_picture
from gelform.result import load_result
from gelform.sensors.files import read_image
from made.files import video
from made.small_gel import calibration, save

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


def test_23_images_of_one_name_give_23_results(works, images, calibration_file, press_folder, tmp_path):
    out = works("reconstruct", *images, "-c", calibration_file, "-o", tmp_path / "out")[0]
    assert {*(tmp_path / "out").rglob("*.npz")} == {tmp_path / f"out/{k}/gelsight.npz" for k in range(23)}
    assert out.count("gelsight.npz") == 23
    result = load_result(tmp_path / "out" / "0" / "gelsight.npz")
    truth = np.load(press_folder / "truth" / "0000.npz")
    assert np.corrcoef(result.depth_mm.ravel(), truth["depth_mm"].ravel())[0, 1] > 0.97


@pytest.fixture
def opened(monkeypatch):
    """What was opened to look at."""
    paths = []
    monkeypatch.setattr(webbrowser, "open", paths.append)
    return paths


def test_a_folder_and_a_pattern_become_depth_to_look_at(
    run, works, images, calibration_file, press_folder, tmp_path, opened
):
    shutil.copy(press_folder / "background.png", tmp_path / "in" / "rest.png")
    rest = ("--background", tmp_path / "in" / "rest.png")
    given = (tmp_path / "in", "-c", calibration_file, "-o", tmp_path / "a", *rest, "--view")
    works("reconstruct", *given)
    pattern = tmp_path / "in" / "*" / "gelsight.png"
    works("reconstruct", pattern, "-c", calibration_file, "-o", tmp_path / "b", *rest)
    outputs = (tmp_path / "a", tmp_path / "b")
    names = [sorted(str(p.relative_to(out)) for p in out.rglob("*.npz")) for out in outputs]
    assert names[0] == names[1] == sorted(f"{k}/gelsight.npz" for k in range(23))
    sheet = tmp_path / "a" / "sheet.png"
    assert opened == [sheet.as_uri()]
    width, height = 200 + 8, 150 + 50 + 8  # of a tile with its gap and its text
    pixels = read_image(sheet)
    assert pixels.shape == (4 * height, 6 * width, 3)
    assert pixels[3 * height : -8, 5 * width : -8].max() == 0, "23 of 24 places"
    assert pixels[3 * height : 3 * height + 150, 4 * width : 4 * width + 200].max() > 200
    assert "already there" in run("reconstruct", *given)[2]


def test_a_video_becomes_whole_results_to_look_at(
    run, works, calibration_file, press_folder, tmp_path, opened
):
    frames = [read_image(press_folder / "images" / f"{k:04d}.png") for k in range(3)]
    path = video(tmp_path / "press.avi", frames)
    given = ("reconstruct", path, "-c", calibration_file, "-o", tmp_path / "out")
    works(*given, "--view")
    result = load_result(tmp_path / "out" / "frames" / "press.avi" / "000002.npz")
    expected = gelform.Reconstructor(calibration_file)(frames[2])
    np.testing.assert_array_equal(result.depth_mm, expected.depth_mm)
    assert opened == [(tmp_path / "out" / "sheet.png").as_uri()]
    assert run(*given, "--format", "npz,png")[0] == 2
    assert run(*given, "--strict")[0] == 2
    code, _, err = run("reconstruct", path, press_folder / "background.png", *given[2:])
    assert code == 1
    assert "press.avi is no image. Give it alone" in err


def test_filled_depth_is_no_peak(run, run_json, calibration_file, press_folder, tmp_path):
    """A quarter of the gel has colors that no slope has, and is filled to 0.8 mm; nothing known is as deep."""
    rest = read_image(press_folder / "background.png")
    odd = np.where((np.arange(rest.shape[1]) < rest.shape[1] // 4)[None, :, None], 255 - rest, rest)
    cv2.imwrite(str(tmp_path / "odd.png"), odd[..., ::-1])
    given = (tmp_path / "odd.png", "-c", calibration_file, "-o")
    (row,) = run_json("reconstruct", *given, tmp_path / "a")["results"]
    result = load_result(tmp_path / "a" / "odd.npz")
    assert row["peak_mm"] == pytest.approx(result.depth_mm[result.known].max(), abs=1e-6)
    assert result.depth_mm.max() > 2 * result.peak_mm
    assert run("batch", *given, tmp_path / "b", "--keep", "all", "--table", "csv")[0] == 0
    (row,) = csv.DictReader((tmp_path / "b" / "frames.csv").open())
    assert float(row["deepest_mm"]) == pytest.approx(result.peak_mm, abs=1e-6)
    assert result.known[int(row["deepest_y_px"]), int(row["deepest_x_px"])]
    both = ("-c", calibration_file, "-c", calibration_file)
    assert run_json("compare", tmp_path / "odd.png", *both)["images"][0]["peak_a"] == pytest.approx(
        result.peak_mm
    )


@pytest.mark.parametrize("how", [["--view"], ["--format", "npz,png"]])
def test_a_lone_image_keeps_its_name_and_gets_a_picture(
    run_json, calibration_file, press_folder, tmp_path, opened, how
):
    image, written = press_folder / "images" / "0003.png", [tmp_path / "0003.npz", tmp_path / "0003.png"]
    (row,) = run_json("reconstruct", image, "-c", calibration_file, "-o", tmp_path, *how)["results"]
    assert sorted(tmp_path.iterdir()) == written
    assert read_image(written[1]).shape[1] > 1000
    assert row["outputs"] == list(map(str, written))
    assert np.isclose(row["peak_mm"], load_result(written[0]).peak_mm)
    assert opened == ([written[1].as_uri()] if how == ["--view"] else [])


def test_another_background_is_a_warning_and_an_error_where_strict(
    run, run_json, calibration_file, press_folder, tmp_path
):
    untouched = read_image(press_folder / "background.png").astype(float)
    save_picture(tmp_path / "brighter.png", np.clip(untouched * 1.15, 0, 255).astype(np.uint8))
    own = ("reconstruct", press_folder / "images" / "0000.png", "-c", calibration_file)
    other = (*own, "--background", tmp_path / "brighter.png")
    assert run_json(*own, "-o", tmp_path / "a", "--strict")["results"][0]["findings"] == []
    assert run(*other, "-o", tmp_path / "d")[0] == 3
    found = run_json(*other, "-o", tmp_path / "b", "--accept-doubtful")["results"][0]["findings"]
    assert {finding["name"] for finding in found} == {"background_ratio"}
    assert run(*other, "-o", tmp_path / "c", "--strict")[0] == 1
    assert load_result(tmp_path / "c" / "0000.npz")


def test_results_stay_unless_overwritten(run, fails, calibration_file, press_folder, tmp_path):
    image = press_folder / "images" / "0000.png"
    (tmp_path / "0000.npz").write_text("mine")
    arguments = ("reconstruct", image, "-c", calibration_file, "-o", tmp_path)
    assert "already there" in fails(*arguments)
    assert (tmp_path / "0000.npz").read_text() == "mine"
    assert run(*arguments, "--overwrite", "--quiet") == (0, "", "")
    assert load_result(tmp_path / "0000.npz")


def test_one_bad_image_does_not_stop_the_others(run, run_json, calibration_file, press_folder, tmp_path):
    good = [press_folder / "images" / f"000{k}.png" for k in range(3)]
    (tmp_path / "bad.png").write_text("no image")
    arguments = ("reconstruct", good[0], tmp_path / "bad.png", *good[1:], "-c", calibration_file)
    code, out, err = run(*arguments, "-o", tmp_path / "out")
    assert code == 1
    assert err.startswith(f"gelform: error: {tmp_path / 'bad.png'} is ")
    assert "3 of 4 images done, 0 skipped, 1 failed." in err
    assert sum(1 for _ in (tmp_path / "out").rglob("*.npz")) == 3
    assert out.count(".npz") == 3
    code, out, _ = run(*arguments, "-o", tmp_path / "again", "--json")
    said = json.loads(out)
    assert (code, len(said["results"])) == (1, 3)
    assert [one["image"] for one in said["failed"]] == [str(tmp_path / "bad.png")]


def test_it_goes_on_where_it_was(run, works, calibration_file, press_folder, tmp_path):
    images = [press_folder / "images" / f"000{k}.png" for k in range(3)]
    out = tmp_path / "out"
    assert run("reconstruct", *images, "-c", calibration_file, "-o", out, "-q")[0] == 0
    (out / "0001.npz").unlink()
    (out / "0002.npz").write_text("mine")
    said, err = works("reconstruct", *images, "-c", calibration_file, "-o", out, "--skip-existing")
    assert "1 of 3 images done, 2 skipped, 0 failed." in err
    assert said.count(".npz") == 1
    assert load_result(out / "0001.npz")
    assert (out / "0002.npz").read_text() == "mine"
    more = ("-c", calibration_file, "-o", out, "--skip-existing", "--format", "npz,ply")
    works("reconstruct", images[1], *more)
    assert (out / "0001.ply").exists(), "one of two files is no result to skip"


def test_a_frame_of_which_nothing_is_known_has_dashes(run, run_json, tmp_path):
    calibration().save(tmp_path / "cal.npz")
    save(tmp_path / "white.png", np.full((64, 80, 3), 255, np.uint8))
    command = ("reconstruct", tmp_path / "white.png", "-c", tmp_path / "cal.npz", "--overwrite", "-o")
    code, out, err = run(*command, tmp_path / "out", "--json")
    assert (code, "no frame was usable" in err) == (1, True)
    (row,) = json.loads(out)["results"]
    assert (row["peak_mm"], row["contact_mm2"], row["contact_px"]) == (None, None, None)
    line = run(*command, tmp_path / "out")[1].splitlines()[2]
    assert line.split()[1:3] == ["-", "-"]
    assert "unknown, 0 at rest" in run("info", tmp_path / "out" / "white.npz")[1]


@pytest.mark.parametrize("suffix", [".npy", ".tiff"])
def test_every_image_of_one_file_is_done(
    run, works, run_json, press_folder, calibration_file, tmp_path, suffix
):
    images = [gelform.read_image(path) for path in sorted((press_folder / "images").iterdir())[:3]]
    path = tmp_path / f"stack{suffix}"
    if suffix == ".npy":
        np.save(path, images)
    else:
        cv2.imwritemulti(str(path), [image[..., ::-1] for image in images])
    works("reconstruct", path, "-c", calibration_file, "-o", tmp_path / "out")
    done = sorted((tmp_path / "out").rglob("*.npz"))
    wanted = gelform.Reconstructor(gelform.load_calibration(calibration_file))
    assert len(done) == 3
    for file, image in zip(done, images):
        np.testing.assert_array_equal(gelform.load_result(file).depth_mm, wanted(image).depth_mm)
    assert run_json("info", path)["frames"] == 3
    (tmp_path / "in").mkdir()
    if suffix == ".tiff":  # arrays in a folder may be anything
        path.rename(tmp_path / "in" / path.name)
        how = ("-c", calibration_file, "-o", tmp_path / "all")
        assert run("batch", tmp_path / "in", *how, "--keep", "all")[0] == 0
        assert len(list((tmp_path / "all").rglob("*.npz"))) == 3
