"""A batch continues after an interruption, only with the same inputs and settings, and finds any change of its output.

Several processes, or Ray, give the bytes of one process; a killed one is reported or repeated; errors are sentences.
"""

import csv
import os
import shutil
import signal
import sys
import threading
import time
from functools import partial
from multiprocessing import active_children
from unittest.mock import patch

import cv2
import numpy as np
import pytest

import gelform
from gelform import DataError, Frame, calibration_from_background
from gelform.batch import BatchSettings, Engine, RunOptions, listing_of, run_batch, verify_output
from gelform.batch.inputs import plan_of
from gelform.batch.records import read_record, record_path
from gelform.batch.run import Job, Stopped, Worker, WorkerLostError, done_parts
from gelform.simulate import LAYOUTS, Ball, simulate_background, simulate_press
from made.small_gel import image_of, save
from made.sources import recorded

PARTS = BatchSettings(part_frames=2)


@pytest.fixture
def done(tree, cal, tmp_path):
    """An output that is complete."""
    assert run_batch(tree, cal, tmp_path / "done", PARTS, table="csv").complete
    return tmp_path / "done"


def test_the_whole_of_it(tree, cal, done):
    rows = list(csv.DictReader((done / "frames.csv").read_text().splitlines()))
    assert [row["frame"] for row in rows] == ["frame1", "frame2", "frame10", "frame11"] * 2
    assert [float(row["deepest_mm"]) for row in rows[:4]] == pytest.approx([0.2, 0.25, 0.3, 0.35], abs=0.02)
    again = run_batch(tree, cal, done, PARTS)
    assert (again.frames, again.frames_before, again.parts_done, again.complete) == (0, 8, 4, True)


def test_shards_give_the_same_bytes_as_one_run(tree, cal, done, tmp_path, visible):
    for number in (3, 1, 2):
        third = RunOptions(shard=(number, 3))
        summary = run_batch(tree, cal, tmp_path / "out", PARTS, options=third, table="csv")
        assert summary.complete == (number == 2)
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
    retried = run_batch(broken_tree, cal, tmp_path / "out", PARTS, options=RunOptions(retry_errors=True))
    assert retried.frames == 4


def test_too_many_errors_end_the_run(broken_tree, cal, tmp_path):
    single, options = BatchSettings(part_frames=1), RunOptions(max_errors=1)
    summary = run_batch(broken_tree, cal, tmp_path / "out", single, options=options)
    assert (summary.stopped, summary.complete, summary.errors) == (True, False, 2)
    assert not (tmp_path / "out" / "frames.csv").exists()


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


def test_what_cannot_be_an_output_is_refused(tree, cal, tmp_path):
    (tmp_path / "file").write_text("")
    for output, options, said in (
        (tree, RunOptions(), "is inside the input"),
        (tree / "out", RunOptions(), "is inside the input"),
        (tree / "day2/out", RunOptions(), "is inside the input"),
        (tree.parent, RunOptions(), "is inside the output"),
        (tmp_path / "file", RunOptions(), "Expected a folder to write to, got the file"),
        (tmp_path / "out", RunOptions(shard=(1, 2), overwrite=True), "A shard cannot overwrite"),
    ):
        with pytest.raises(DataError, match=said):
            run_batch(tree, cal, output, options=options)
    assert not list(tmp_path.rglob("manifest.json"))
    assert run_batch(tree / "frame1.png", cal, tree / "out").complete, "a file may have it beside it"


def test_frames_all_of_another_size_are_refused_before_the_work(tmp_path, cal):
    (tmp_path / "in").mkdir()
    save(tmp_path / "in" / "a.png", np.zeros((10, 12, 3), np.uint8))
    with pytest.raises(DataError, match="use the one of this sensor"):
        run_batch(tmp_path / "in", cal, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_may_not_be_written_is_said(tree, cal, tmp_path):
    (tmp_path / "out").mkdir(mode=0o500)
    with pytest.raises(DataError, match=r"Cannot write into .*: Permission denied"):
        run_batch(tree, cal, tmp_path / "out")


def job(cal, output, **settings):
    return Job(cal, None, output, BatchSettings(**settings))


def test_a_background_of_each_sequence(two_lights, cal, tmp_path):
    """With its own background each is flat at rest."""
    worker = Worker(job(cal, tmp_path / "out", background_frames=1))
    for part in plan_of(listing_of(two_lights), 1, 1):
        (row,) = worker.do(part).rows
        assert abs(row["deepest_mm"]) < 0.02, row


def test_a_starter_of_each_sequence(tmp_path):
    """Two units of a make, whose gains differ by more than exposure does."""
    layout, make = LAYOUTS["three-edges"], "simulated-three-edges"
    rng = np.random.default_rng(0)
    for name, gain in (("one", [1, 1, 1]), ("other", [0.55, 0.9, 0.75])):
        (tmp_path / "in" / name).mkdir(parents=True)
        rest = [simulate_background(layout, rng) for _ in range(3)]
        touched = simulate_press(layout, Ball(2.5), depth_mm=0.4, rng=rng).image
        for k, image in enumerate([*rest, touched]):
            save(tmp_path / "in" / name / f"{k}.png", np.rint(image * np.array(gain)).astype(np.uint8))
    settings, starter = BatchSettings(background_frames=3), partial(calibration_from_background, sensor=make)
    assert run_batch(tmp_path / "in", None, tmp_path / "out", settings, starter=starter).complete
    for name in ("one", "other"):
        depths = [np.load(tmp_path / "out" / "frames" / name / f"{k}.npz")["depth_mm"] for k in range(4)]
        assert max(depth.max() for depth in depths[:3]) < 0.05
        assert depths[3].max() == pytest.approx(0.4, abs=0.1)


def test_after_a_lack_of_memory_no_frame_gets_the_background_of_another_sequence(two_lights, cal, tmp_path):
    """The second sequence has two frames; memory lacks while its background is prepared for the first of them."""
    worker = Worker(job(cal, tmp_path / "out", background_frames=1))
    first, second = plan_of(listing_of(two_lights), 2, 1)
    worker.do(first)
    with patch("gelform.batch.run.background_of_film", side_effect=[MemoryError, image_of(None)]) as prepared:
        without, row = worker.do(second).rows
    assert "Not enough memory" in without["error"]
    assert (prepared.call_count, row["error"]) == (2, "")


def test_a_sequence_without_a_background_has_its_reason_in_every_row(tree, cal, tmp_path):
    (tree / "frame1.png").write_bytes(b"")
    parts = plan_of(listing_of(tree), 256, 1)
    worker = Worker(job(cal, tmp_path / "out", background_frames=1))
    rows = worker.do(parts[0]).rows
    assert [row["error"].startswith("No background") for row in rows] == [False, True, True, True]
    assert "none of the first 1 frames can be read" in rows[1]["error"]
    assert all("is empty" in row["error"] for row in rows)


def test_each_corrupt_frame_is_reported_with_its_reason_and_the_others_are_done(broken_tree, cal, tmp_path):
    done = Worker(job(cal, tmp_path)).do(plan_of(listing_of(broken_tree), 99)[0])
    rows = {row["frame"]: row for row in done.rows}
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


@pytest.fixture
def output(broken_tree, cal, tmp_path):
    run_batch(broken_tree, cal, tmp_path / "out", BatchSettings(part_frames=4), table="csv")
    return tmp_path / "out"


def flipped(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def test_one_thing_is_wrong(output, tmp_path):
    for damage, said in [
        (lambda out: (out / "frames/frame1.npz").unlink(), "is missing"),
        (lambda out: (out / "frames/frame1.npz").write_bytes(b"12345"), "has 5 of"),
        (lambda out: flipped(out / "frames/frame1.npz"), "was altered"),
        (lambda out: (out / "frames/more.npz").write_bytes(b""), "no part knows of it"),
        (lambda out: flipped(out / "frames.csv"), "was altered"),
        (lambda out: flipped(out / "sheet.png"), "was altered"),
        (lambda out: (out / "frames.csv").unlink(), "is missing"),
        (lambda out: flipped(record_path(out, 0)), "is damaged. Delete it"),
    ]:
        shutil.copytree(output, damaged := tmp_path / "damaged")
        damage(damaged)
        _, _, problems = verify_output(damaged)
        assert said in problems[0].what
        shutil.rmtree(damaged)


def test_a_run_that_ends_early_keeps_the_frames_that_are_done(images, cal, tmp_path):
    (tmp_path / "in").mkdir()
    for k in range(40):
        cv2.imwrite(str(tmp_path / "in" / f"{k}.png"), images[k % len(images)][..., ::-1])
    seen = []

    def interrupted(summary):
        seen.append(summary.frames)
        if summary.frames >= 32:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_batch(tmp_path / "in", cal, tmp_path / "out", table="csv", progress=interrupted)
    assert [frames for frames in seen if frames] == [16, 32], "progress at least every 16 frames"
    assert verify_output(tmp_path / "out")[0] == 32
    again = run_batch(tmp_path / "in", cal, tmp_path / "out", table="csv")
    assert (again.frames, again.frames_before, again.complete) == (8, 32, True)


def test_a_run_that_was_killed_before_its_first_frame_is_to_be_run_again(tmp_path):
    (tmp_path / ".lock").touch()
    with pytest.raises(
        DataError, match=r"has no frame: its batch ended before the first one\. Run the batch again"
    ):
        verify_output(tmp_path)
    (tmp_path / "mine.txt").touch()
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(DataError, match=r"has no manifest\.json"):
            verify_output(folder)


def test_a_recording_that_was_copied_in_part_is_a_warning(tmp_path, cal):
    pytest.importorskip("mcap")
    whole = recorded(tmp_path / "a.mcap", [Frame(image_of(None), k / 25, k, k) for k in range(40)])
    content = whole.read_bytes()
    assert run_batch(whole, cal, tmp_path / "out").warnings == ()
    (tmp_path / "b.mcap").write_bytes(content[:-100])
    (said,) = run_batch(tmp_path / "b.mcap", cal, tmp_path / "out2").warnings
    assert "b.mcap has no end: its recorder was killed, or it was copied in part" in said


def test_a_whole_output_and_a_part_that_is_not_done(output):
    (output / "frames" / ".gelform-0123456789ab.tmp").touch()  # of a killed run
    assert verify_output(output) == (8, 4, [])
    record_path(output, 2).unlink()
    assert "1 of 3 parts are not done" in verify_output(output)[2][0].what


ON_POSIX = pytest.mark.skipif(os.name != "posix", reason="kills a process")


@ON_POSIX
@pytest.mark.slow
def test_two_processes_and_one_of_them_killed(tree, cal, tmp_path, visible):
    parts = plan_of(listing_of(tree), 1)
    alone = Job(cal, None, tmp_path / "one", BatchSettings())
    assert list(done_parts(alone, parts, 1)) == [(1, 0)] * len(parts)
    killed = Job(cal, None, tmp_path / "two", BatchSettings())
    before = set(active_children())
    done = done_parts(killed, parts * 50, 2)  # the same again and again: longer than the kill takes
    next(done)
    workers = set(active_children()) - before
    assert len(workers) == 2
    os.kill(workers.pop().pid, signal.SIGKILL)
    with pytest.raises(WorkerLostError, match="What is done is kept, and not done again"):
        list(done)
    assert any(read_record(killed.output, part.number) for part in parts)
    one, two = visible(tmp_path / "one"), visible(tmp_path / "two")
    assert {name: one[name] for name in two} == two


def test_refused(tree, cal, tmp_path, monkeypatch):
    for wrong, said in (
        ({"name": "dask"}, "Expected an engine among pool, ray, got 'dask'"),
        ({"workers": 0}, "at least one worker"),
        ({"address": "auto"}, "an address with the engine ray, got one with pool"),
    ):
        with pytest.raises(ValueError, match=said):
            Engine(**wrong)
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(DataError, match=r"gelform\[ray\]"):
        run_batch(tree, cal, tmp_path / "out", PARTS, engine=RAY)


RAY = Engine("ray", 2)


@pytest.fixture(scope="module")
def ray():
    ray = pytest.importorskip("ray", reason="the extra ray is not installed")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    yield ray
    ray.shutdown()


@pytest.mark.slow
def test_the_same_bytes_as_without(ray, broken_tree, cal, tmp_path, visible):
    here = run_batch(broken_tree, cal, tmp_path / "a", PARTS, table="csv")
    there = run_batch(broken_tree, cal, tmp_path / "b", PARTS, table="csv", engine=RAY)
    assert (there.frames, there.errors, there.complete) == (here.frames, 4, True)
    assert visible(tmp_path / "a") == visible(tmp_path / "b")


@ON_POSIX
@pytest.mark.slow
def test_a_worker_that_is_killed_is_done_again(ray, tree, cal, tmp_path, visible):
    @ray.remote
    def number():
        return os.getpid()

    numbers = set(ray.get([number.remote() for _ in range(8)]))

    def kill():
        time.sleep(0.3)
        for one in numbers:
            os.kill(one, signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    single = BatchSettings(part_frames=1)
    assert run_batch(tree, cal, tmp_path / "b", single, table="csv", engine=RAY).complete
    killer.join()
    run_batch(tree, cal, tmp_path / "a", single, table="csv")
    assert visible(tmp_path / "a") == visible(tmp_path / "b")


@pytest.mark.slow
def test_an_output_that_cannot_be_written_is_our_error(ray, tree, cal, tmp_path):
    (tmp_path / "out/frames/frame1.npz").mkdir(parents=True)
    run = {"settings": PARTS, "engine": RAY}
    (tmp_path / "out/frames").rename(tmp_path / "kept")
    assert run_batch(tree, cal, tmp_path / "out", **run).complete
    (tmp_path / "out/frames/frame1.npz").unlink()
    (tmp_path / "out/frames/frame1.npz").mkdir()
    with pytest.raises(DataError, match="got the folder"):
        run_batch(tree, cal, tmp_path / "out", **run)
