"""gelform reconstruct: images with the same name give as many results, and no result is partial.

gelform batch and gelform verify: figures, exit status, refusals in one line.
"""

import csv
import json
import shutil
import sys
import webbrowser

import cv2
import numpy as np
import pytest

import gelform
from gelform.cli.commands.reconstruct import _line
from gelform.cli.console import status_of
from gelform.errors import FrameTally
from gelform.exchange.plots import save_picture
from gelform.result import load_result
from gelform.sensors.files import read_image
from hostile.commands import make_work
from made.small_gel import calibration, save
from made.sources import video_file


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
    pytest.importorskip("matplotlib", reason="pictures need the extra 'plots'")
    paths = []
    monkeypatch.setattr(webbrowser, "open", paths.append)
    return paths


def test_a_sheet_that_leaves_out_images_is_said(
    works, images, calibration_file, tmp_path, opened, monkeypatch
):
    monkeypatch.setattr(sys.modules["gelform.cli.commands.reconstruct"], "TILES", 4)
    given = (tmp_path / "in", "-c", calibration_file)
    _, err = works("reconstruct", *given, "-o", tmp_path / "a", "--view")
    assert "sheet.png, which shows 4 of 23 images." in " ".join(err.split())
    _, err = works("batch", *given, "-o", tmp_path / "b", "--table", "csv")
    assert "sheet.png, which shows 4 of 23." in " ".join(err.split())
    assert opened


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
    path = video_file(tmp_path / "press.avi", frames, "FFV1")
    given = ("reconstruct", path, "-c", calibration_file, "-o", tmp_path / "out")
    works(*given, "--view")
    result = load_result(tmp_path / "out" / "frames" / "press.avi" / "000002.npz")
    expected = gelform.Reconstructor(calibration_file)(frames[2])
    np.testing.assert_array_equal(result.depth_mm, expected.depth_mm)
    assert opened == [(tmp_path / "out" / "sheet.png").as_uri()]
    works(*given, "--format", "npz,png,ply")
    for form in ("png", "ply"):
        assert sorted(one.name for one in (tmp_path / "out" / form / "press.avi").iterdir()) == [
            f"{k:06d}.{form}" for k in range(3)
        ]
    works("verify", tmp_path / "out")
    code, _, err = run(*given, "--strict", "--format", "npz,png")
    assert code == 2
    assert "Invalid value for --strict: is for images" in err
    assert "--format" not in err
    assert "--skip-existing: is for images" in run(*given, "--skip-existing")[2]
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


def test_one_error_of_several_images_is_said_once(run, calibration_file, tmp_path):
    for k in range(4):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.zeros((20 + 4 * (k == 3), 30, 3), np.uint8))
    _, _, err = run(
        "reconstruct", *sorted(tmp_path.glob("*.png")), "-c", calibration_file, "-o", tmp_path / "out"
    )
    first, other = (line for line in err.splitlines() if "error:" in line)
    assert first.startswith(f"gelform: error: {tmp_path / '0.png'}")
    assert "2 more images with this error" in first
    assert f"{tmp_path / '3.png'}" in other
    assert "more" not in other


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


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    return make_work(tmp_path_factory.mktemp("work"))


@pytest.fixture
def pattern(work):
    return str(work / "image*.png")


def test_a_pattern_to_depth_and_on_with_it(run, run_json, work, pattern, tmp_path):
    code, out, err = run("batch", pattern, "-c", work / "cal.npz", "-o", tmp_path / "out")
    assert (code, out) == (0, "")
    assert "3 frames done; 0 with errors." in err
    assert "Complete: " in err
    figures = run_json("batch", pattern, "-c", work / "cal.npz", "-o", tmp_path / "out")
    assert (figures["frames"], figures["frames_before"], figures["complete"]) == (0, 3, True)


def test_frames_with_errors_end_with_status_1(run, work, pattern, tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "good.png").write_bytes((work / "image0.png").read_bytes())
    (tmp_path / "in" / "empty.png").write_bytes(b"")
    command = ("batch", tmp_path / "in", "-c", work / "cal.npz", "-o", tmp_path / "out")
    code, out, _ = run(*command, "--json")
    assert code == 1
    assert json.loads(out)["errors"] == 1
    code, _, err = run(*command, "--max-errors", "0", "--retry-errors")
    assert code == 1
    assert "with errors, more than --max-errors 0 allows" in err.replace("\n", " ")


def test_every_frame_failed_for_a_reason_that_is_said(run, work, tmp_path):
    (tmp_path / "in").mkdir()
    for k in range(3):
        image = cv2.imread(str(work / f"image{k}.png"))
        cv2.imwrite(str(tmp_path / "in" / f"{k}.png"), np.ascontiguousarray(image[:, ::-1]))
    (tmp_path / "in" / "empty.png").write_bytes(b"")
    command = ("batch", tmp_path / "in", "-c", work / "cal.npz", "-o", tmp_path / "out")
    code, out, err = run(*command, "--json")
    assert code == 1
    tally = json.loads(out)["tally"]
    assert (tally["frames"], tally["failed"], sorted(tally["reasons"].values())) == (0, 4, [1, 3])
    assert "4 of 4 frames failed. The commonest reason (3 frames): The image is mirrored" in err
    said = run(*command)[2]
    assert "has a row for each frame.\n" in said, "and no sheet of depth to look at"


@pytest.mark.parametrize("command", ["batch", "reconstruct", "bag"])
def test_frames_of_another_sensor_are_no_success(run, foreign_images, calibration_file, tmp_path, command):
    if command == "bag":
        pytest.importorskip("rosbags", reason="the extra ros is not installed")
        pytest.importorskip("mcap", reason="the extra mcap is not installed")
    more = ("--table", "csv") if command == "batch" else ()
    given = (command, foreign_images, "-c", calibration_file, *more, "-o")
    code, out, err = run(*given, tmp_path / "out", "--json")
    assert code == 3
    assert "the depth of 4 of 4 frames is doubtful (background_differs in 4)" in err
    assert "The last frame" not in err, "its depth is known"
    if command == "batch":
        with (tmp_path / "out" / "frames.csv").open() as file:
            assert min(float(row["deepest_mm"]) for row in csv.DictReader(file)) > 1.5, "and it is 0.4"
    if command != "reconstruct":
        tally = json.loads(out)["tally"]
        assert [tally[name] for name in ("frames", "doubtful", "failed", "unknown")] == [4, 4, 0, 0]
    again = tmp_path / ("out" if command == "batch" else "again")  # frames of earlier runs count too
    code, _, err = run(*given, again, "--accept-doubtful")
    assert code == 0
    assert command == "reconstruct" or "Findings in 4 frames: background_differs 100 %" in err


def test_the_table_is_csv_where_parquet_cannot_be_written(works, work, pattern, tmp_path, monkeypatch):
    monkeypatch.setattr("gelform.batch.records.find_spec", lambda name: None)
    for more, said in (((), True), (("--table", "csv"), False)):
        out = tmp_path / f"out{said}"
        err = works("batch", pattern, "-c", work / "cal.npz", "-o", out, *more)[1]
        assert ("The table is CSV, because pyarrow (the extra data) is not installed." in err) is said
        assert (out / "frames.csv").exists()


def test_a_shard_says_that_others_are_to_come(works, work, pattern, tmp_path):
    err = works("batch", pattern, "-c", work / "cal.npz", "-o", tmp_path / "out", "--shard", "2/2")[1]
    assert "This shard is done" in err


def test_progress_says_rate_and_time_left():
    from gelform.batch import BatchSummary

    summary = BatchSummary(parts=10, parts_done=4, frames=512, errors=3)
    assert _line(summary, 2.0, 2) == "4 of 10 parts, 256.0 frames/s, 0:00:06 left, 3 with errors"


def test_what_is_wrong_with_an_output_is_listed_up_to_20_lines(run, works, run_json, pattern, work, tmp_path):
    output = tmp_path / "out"
    assert run("batch", pattern, "-c", work / "cal.npz", "-o", output, "--quiet") == (0, "", "")
    assert "complete: 3 frames; with an error: 0; 0 problems." in works("verify", output)[1]
    assert run_json("verify", output) == {"frames": 3, "errors": 0, "problems": []}
    (output / "frames" / "image1.npz").unlink()
    code, _, err = run("verify", output)
    assert code == 1
    assert "image1.npz: is missing. Run the same command again." in err
    for k in range(20):
        (output / "frames" / f"{k}.npz").touch()
    err = run("verify", output)[2]
    assert (err.count("no part knows of it"), "1 more; all with --json." in err) == (19, True)
    code, out, _ = run("verify", output, "--json")
    said = json.loads(out)
    assert (code, said["frames"], len(said["problems"])) == (1, 2, 21)


GOOD, DOUBTFUL, UNKNOWN = ([], True), (["beyond_gel"], True), (["not_this_gel"], False)


@pytest.mark.parametrize(
    ("frames", "failed", "status", "accepted"),
    [
        ([GOOD, DOUBTFUL], 0, 0, 0),
        ([GOOD, DOUBTFUL, DOUBTFUL], 0, 3, 0),
        ([GOOD, UNKNOWN, UNKNOWN], 0, 3, 0),
        ([UNKNOWN], 0, 1, 1),
        ([GOOD], 1, 1, 1),
        ([DOUBTFUL], 1, 1, 1),
        ([], 2, 1, 1),
        ([], 0, 0, 0),
    ],
)
def test_what_the_frames_make_of_the_status(frames, failed, status, accepted):
    tally = FrameTally()
    for names, known in frames:
        tally.add(names, known=known)
    for _ in range(failed):
        tally.add_failed("it is empty")
    assert status_of(tally, accept_doubtful=False, quiet=True) == status
    assert status_of(tally, accept_doubtful=True, quiet=True) == accepted


def test_few_frames_are_no_zero_percent(capsys):
    tally = FrameTally()
    for k in range(300):
        tally.add(["steep"] * (k == 0), known=True)
    status_of(tally, accept_doubtful=False, quiet=False)
    assert capsys.readouterr().err == "Findings in 300 frames: steep under 1 %.\n"
