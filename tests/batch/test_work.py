"""A part is a pure function: the same as reconstructing by hand, whatever was done before."""

import numpy as np
import pytest

import gelform
from gelform.batch.inputs.listing import listing_of
from gelform.batch.inputs.plan import plan_of
from gelform.batch.records import read_record
from gelform.batch.settings import BatchSettings
from gelform.batch.work import Job, Stopped, Worker
from made.small_gel import image_of, save


def job(cal, output, **settings):
    return Job(cal, None, output, BatchSettings(**settings))


def test_the_same_depth_as_by_hand(tree, cal, images, tmp_path):
    out = tmp_path / "out"
    parts = plan_of(listing_of(tree), 256)
    record = Worker(job(cal, out)).do(parts[1])
    assert read_record(out, 1) == record
    assert [row["output"] for row in record.rows][2] == "frames/day2/frame10.npz"
    with np.load(out / "frames/day2/frame10.npz") as file:
        np.testing.assert_array_equal(
            file["depth_mm"], gelform.Reconstructor(cal).from_image(images[2]).depth_mm
        )


def test_a_background_of_each_sequence(tmp_path, cal):
    """The gel of the second sequence has a brighter red light: with its own background its rest is flat all the same."""
    rest = image_of(None)
    brighter = np.clip(rest * np.array([1.1, 1, 1]), 0, 255).astype(np.uint8)
    for name, image in (("a", rest), ("b", brighter)):
        (tmp_path / "in" / name).mkdir(parents=True)
        for k in range(2):
            save(tmp_path / "in" / name / f"{k}.png", image)
    settings = {"background_frames": 1}
    worker = Worker(job(cal, tmp_path / "out", **settings))
    for part in plan_of(listing_of(tmp_path / "in"), 1, 1):
        (row,) = worker.do(part).rows
        assert abs(row["deepest_mm"]) < 0.02, row


def test_a_sequence_without_a_background_has_its_reason_in_every_row(tree, cal, tmp_path):
    (tree / "frame1.png").write_bytes(b"")
    parts = plan_of(listing_of(tree), 256, 1)
    worker = Worker(job(cal, tmp_path / "out", background_frames=1))
    rows = worker.do(parts[0]).rows
    assert [row["error"].startswith("No background") for row in rows] == [False, True, True, True]
    assert all("is empty" in row["error"] for row in rows)


def test_each_corrupt_frame_is_reported_with_its_reason_and_the_others_are_done(broken_tree, cal, tmp_path):
    rows = {
        row["frame"]: row
        for row in Worker(job(cal, tmp_path)).do(plan_of(listing_of(broken_tree), 99)[0]).rows
    }
    reasons = {name: row["error"] for name, row in rows.items() if row["error"]}
    assert reasons.keys() == {"cut", "empty", "text", "wide"}
    for name, said in {"cut": "truncated", "empty": "is empty", "text": "no image", "wide": "160"}.items():
        assert said in reasons[name]
        assert not rows[name]["output"]
    assert all((tmp_path / row["output"]).exists() for name, row in rows.items() if name not in reasons)


def test_stopped_between_two_frames(tree, cal, tmp_path):
    with pytest.raises(Stopped):
        Worker(job(cal, tmp_path / "out")).do(plan_of(listing_of(tree), 99)[0], lambda: True)
    assert read_record(tmp_path / "out", 0) is None


def test_a_video_keeps_its_times(film, cal, tmp_path):
    rows = Worker(job(cal, tmp_path / "out", keep=("all",))).do(plan_of(listing_of(film), 99)[0]).rows
    assert [row["time_s"] for row in rows] == pytest.approx([0, 0.04, 0.08, 0.12])
    assert gelform.load_result(tmp_path / "out/frames/press.avi/000003.npz").time_s == pytest.approx(0.12)
