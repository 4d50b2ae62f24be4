"""A batch goes on where it was left, with the same and nothing else; what cannot be is said before the work."""

import csv
import os

import numpy as np
import pytest

from gelform.batch import BatchSettings, RunOptions, run_batch
from gelform.errors import DataError
from made.small_gel import image_of, save

PARTS = BatchSettings(part_frames=2)


@pytest.fixture
def done(tree, cal, tmp_path):
    """An output that is complete."""
    assert run_batch(tree, cal, tmp_path / "done", PARTS, table="csv").complete
    return tmp_path / "done"


def test_the_whole_of_it(tree, cal, done):
    with (done / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["frame"] for row in rows] == ["frame1", "frame2", "frame10", "frame11"] * 2
    assert [float(row["deepest_mm"]) for row in rows[:4]] == pytest.approx([0.2, 0.25, 0.3, 0.35], abs=0.02)
    again = run_batch(tree, cal, done, PARTS)
    assert (again.frames, again.frames_before, again.parts_done, again.complete) == (0, 8, 4, True)


def test_shards_give_the_same_bytes_as_one_run(tree, cal, done, tmp_path, visible):
    for number in (3, 1):
        assert not run_batch(
            tree, cal, tmp_path / "out", PARTS, options=RunOptions(shard=(number, 3)), table="csv"
        ).complete
    assert run_batch(
        tree, cal, tmp_path / "out", PARTS, options=RunOptions(shard=(2, 3)), table="csv"
    ).complete
    assert visible(tmp_path / "out") == visible(done)


def test_only_what_is_missing_is_done(tree, cal, done, visible):
    before = visible(done)
    (done / "frames/day2/frame2.npz").unlink()
    (done / "frames/frame11.npz").write_bytes(b"torn")
    summary = run_batch(tree, cal, done, PARTS, table="csv")
    assert (summary.frames, summary.frames_before) == (4, 4)  # their two parts
    assert visible(done) == before


def test_a_file_that_was_replaced_is_done_again(broken_tree, cal, tmp_path, images):
    first = run_batch(broken_tree, cal, tmp_path / "out", PARTS)
    assert (first.errors, first.complete) == (4, True)
    save(broken_tree / "empty.png", images[0])
    again = run_batch(broken_tree, cal, tmp_path / "out", PARTS)
    assert (again.errors, again.frames) == (3, 2)
    assert (
        run_batch(broken_tree, cal, tmp_path / "out", PARTS, options=RunOptions(retry_errors=True)).frames
        == 4
    )


def test_too_many_errors_end_the_run(broken_tree, cal, tmp_path):
    summary = run_batch(
        broken_tree, cal, tmp_path / "out", BatchSettings(part_frames=1), options=RunOptions(max_errors=1)
    )
    assert (summary.stopped, summary.complete, summary.errors) == (True, False, 2)
    assert not (tmp_path / "out" / "frames.csv").exists()


def test_temporary_files_of_a_killed_run_go(tree, cal, done):
    (done / "frames/frame1.npz").unlink()
    left = done / "frames" / ".gelform-0123456789ab.tmp"
    left.write_bytes(b"half")
    run_batch(tree, cal, done, PARTS)
    assert not left.exists()


def test_something_else_is_refused_unless_it_may_begin_anew(tree, cal, done, visible):
    before = visible(done)
    other = BatchSettings(part_frames=2, form="png")
    with pytest.raises(DataError, match=r"the setting form \(npz then, png now\)"):
        run_batch(tree, cal, done, other)
    save(tree / "frame12.png", image_of(None))
    with pytest.raises(DataError, match="the list of input files"):
        run_batch(tree, cal, done, PARTS)
    assert visible(done) == before
    assert run_batch(tree, cal, done, other, options=RunOptions(overwrite=True)).complete
    assert {path.suffix for path in (done / "frames").rglob("*.*")} == {".png"}


def test_the_background_given_is_used_and_is_no_frame(tree, cal, tmp_path):
    save(tree / "rest.png", image_of(None))
    summary = run_batch(tree, cal, tmp_path / "out", PARTS, background=tree / "rest.png")
    assert (summary.frames, summary.errors) == (8, 0)
    with pytest.raises(DataError, match="the background"):
        run_batch(tree, cal, tmp_path / "out", PARTS, background=tree / "frame1.png")


def test_an_output_inside_the_input_is_refused(tree, cal):
    for inside in ["", "out", "day2/out"]:
        with pytest.raises(DataError, match="is inside the input"):
            run_batch(tree, cal, tree / inside)
        assert not (tree / "manifest.json").exists()


def test_an_input_inside_the_output_is_refused(tree, cal):
    with pytest.raises(DataError, match="is inside the output"):
        run_batch(tree, cal, tree.parent)


def test_a_file_may_have_its_output_beside_it(tree, cal):
    assert run_batch(tree / "frame1.png", cal, tree / "out").complete


def test_frames_all_of_another_size_are_refused_before_the_work(tmp_path, cal):
    (tmp_path / "in").mkdir()
    save(tmp_path / "in" / "a.png", np.zeros((10, 12, 3), np.uint8))
    with pytest.raises(DataError, match="use the one of this sensor"):
        run_batch(tmp_path / "in", cal, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_file_is_no_output(tree, cal, tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(DataError, match="Expected a folder to write to, got the file"):
        run_batch(tree, cal, tmp_path / "out")


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_may_not_be_written_is_said(tree, cal, tmp_path):
    (tmp_path / "out").mkdir(mode=0o500)
    with pytest.raises(DataError, match=r"Cannot write into .*: Permission denied"):
        run_batch(tree, cal, tmp_path / "out")


def test_a_shard_may_not_overwrite(tree, cal, tmp_path):
    with pytest.raises(DataError, match="A shard cannot overwrite"):
        run_batch(tree, cal, tmp_path / "out", options=RunOptions(shard=(1, 2), overwrite=True))
