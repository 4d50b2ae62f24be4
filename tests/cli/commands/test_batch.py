"""gelform batch and gelform verify: figures, exit status, refusals in one line."""

import csv
import json

import cv2
import numpy as np
import pytest

from gelform.cli.commands.reconstruct import _line
from gelform.cli.console import status_of
from gelform.errors import FrameTally
from hostile.commands import make_work


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    return make_work(tmp_path_factory.mktemp("work"))


@pytest.fixture
def images(work):
    return str(work / "image*.png")


def test_a_pattern_to_depth_and_on_with_it(run, run_json, work, images, tmp_path):
    code, out, err = run("batch", images, "-c", work / "cal.npz", "-o", tmp_path / "out")
    assert (code, out) == (0, "")
    assert "3 frames done; 0 with errors." in err
    assert "Complete: " in err
    figures = run_json("batch", images, "-c", work / "cal.npz", "-o", tmp_path / "out")
    assert (figures["frames"], figures["frames_before"], figures["complete"]) == (0, 3, True)


def test_frames_with_errors_end_with_status_1(run, work, images, tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "good.png").write_bytes((work / "image0.png").read_bytes())
    (tmp_path / "in" / "empty.png").write_bytes(b"")
    command = ("batch", tmp_path / "in", "-c", work / "cal.npz", "-o", tmp_path / "out")
    code, out, _ = run(*command, "--json")
    assert code == 1
    assert json.loads(out)["errors"] == 1
    code, _, err = run(*command, "--max-errors", "0", "--retry-errors")
    assert code == 1
    assert "more than --max-errors 0 allows" in err


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


def test_the_table_is_csv_where_parquet_cannot_be_written(works, work, images, tmp_path, monkeypatch):
    monkeypatch.setattr("gelform.batch.records.find_spec", lambda name: None)
    for more, said in (((), True), (("--table", "csv"), False)):
        out = tmp_path / f"out{said}"
        err = works("batch", images, "-c", work / "cal.npz", "-o", out, *more)[1]
        assert ("The table is CSV, because pyarrow (the extra data) is not installed." in err) is said
        assert (out / "frames.csv").exists()


def test_a_shard_says_that_others_are_to_come(works, work, images, tmp_path):
    err = works("batch", images, "-c", work / "cal.npz", "-o", tmp_path / "out", "--shard", "2/2")[1]
    assert "This shard is done" in err


def test_progress_says_rate_and_time_left():
    from gelform.batch import BatchSummary

    summary = BatchSummary(parts=10, parts_done=4, frames=512, errors=3)
    assert _line(summary, 2.0, 2) == "4 of 10 parts, 256.0 frames/s, 0:00:06 left, 3 with errors"


def test_what_is_wrong_with_an_output_is_listed_up_to_20_lines(run, works, run_json, images, work, tmp_path):
    output = tmp_path / "out"
    assert run("batch", images, "-c", work / "cal.npz", "-o", output, "--quiet") == (0, "", "")
    assert "3 frames are complete, 0 have an error, 0 problems." in works("verify", output)[1]
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
