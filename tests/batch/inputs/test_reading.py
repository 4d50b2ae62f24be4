"""Frames of folders, videos and recordings; what cannot be read says why, and the others come."""

import numpy as np
import pytest

import gelform
from gelform.batch import run_batch
from gelform.batch.inputs.listing import listing_of
from gelform.batch.inputs.plan import plan_of
from gelform.batch.inputs.reading import (
    background_of_sequence,
    backgrounds_of,
    frames_of_part,
    image_of_calibration,
)
from gelform.batch.manifest import read_manifest
from gelform.errors import DataError
from gelform.frames import Frame
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.image_folder import FolderRecording
from made.small_gel import image_of, save


def parts_of(source, part_frames=256, background_frames=0):
    return plan_of(listing_of(source), part_frames, background_frames)


def test_images_in_their_order(tree, images):
    found = [one for part in parts_of(tree, 3)[:2] for one in frames_of_part(part)]
    assert [one.name for one in found] == ["frame1", "frame2", "frame10", "frame11"]
    assert [one.index for one in found] == [0, 1, 2, 3]
    for one, image in zip(found, images):
        np.testing.assert_array_equal(one.frame.image, image)


def test_what_cannot_be_read_says_why(broken_tree):
    found = {one.name: one for one in frames_of_part(parts_of(broken_tree)[0])}
    assert "truncated" in found["cut"].error
    assert "is empty" in found["empty"].error
    assert "no image" in found["text"].error
    assert found["frame2"].frame is not None


def test_a_video(film, images):
    found = list(frames_of_part(parts_of(film)[0]))
    assert [one.name for one in found] == ["000000", "000001", "000002", "000003"]
    assert np.abs(found[2].frame.image.astype(int) - images[2]).max() <= 1
    assert found[2].frame.time_s == pytest.approx(0.08)


def test_a_damaged_video_is_one_frame_with_its_error(film):
    film.write_bytes(film.read_bytes()[:40])
    (only,) = frames_of_part(parts_of(film)[0])
    assert only.frame is None
    assert "press.avi" in only.error


def test_a_recording_with_its_times(tmp_path, images):
    recording = FolderRecording(tmp_path / "recorded", RecordingFacts("camera"))
    for index, image in enumerate(images):
        recording.write(Frame(image, 5 + 0.1 * index, 1000 + index, 7 + index))
    recording.close()
    found = list(frames_of_part(parts_of(tmp_path / "recorded")[0]))
    assert [one.frame.wall_time_ns for one in found] == [1000, 1001, 1002, 1003]
    assert found[3].frame.time_s == pytest.approx(0.3)


def test_a_frame_of_another_size_is_refused(cal):
    with pytest.raises(DataError, match="64"):
        image_of_calibration(Frame(np.zeros((10, 12, 3), np.uint8), 0, 0, 0), cal)


def test_the_background_is_the_average_of_the_first_frames(tmp_path, cal):
    for k in range(3):
        save(tmp_path / f"{k}.png", image_of(None))
    parts = parts_of(tmp_path, 2, 2)
    for part in parts:
        found = background_of_sequence(part, 2, cal)
        np.testing.assert_allclose(found, image_of(None), atol=1)


def test_a_background_that_cannot_be_is_said(tmp_path, cal):
    (tmp_path / "0.png").write_bytes(b"")
    with pytest.raises(DataError, match=r"none of the first 1 frames can be read: .*is empty"):
        background_of_sequence(parts_of(tmp_path, 2, 1)[0], 1, cal)


RED = np.array([1.1, 1, 1])


@pytest.fixture
def two_lights(tmp_path):
    """Two sequences of an untouched gel, the second under a brighter red light; their backgrounds lie among them."""
    for name, factor in (("a", 1), ("b", RED)):
        image = np.clip(image_of(None) * factor, 0, 255).astype(np.uint8)
        (tmp_path / "in" / name).mkdir(parents=True)
        for one in ("0.png", "rest.png"):
            save(tmp_path / "in" / name / one, image)
    return tmp_path / "in"


def table(folder, *rows):
    path = folder / "rest.csv"
    path.write_text("\n".join(("sequence,background", *rows)) + "\n")
    return path


def test_each_sequence_has_the_background_that_the_table_names(two_lights, cal, tmp_path):
    rest = table(two_lights, "a,a/rest.png", "b,b/rest.png")
    run_batch(two_lights, cal, tmp_path / "own", background=rest)
    assert len(list((tmp_path / "own/frames").rglob("*.npz"))) == 2  # the backgrounds are no frames
    for name in "ab":
        image = gelform.read_image(two_lights / name / "0.png")
        expected = gelform.Reconstructor(cal, background=image).from_image(image).depth_mm
        with np.load(tmp_path / "own/frames" / name / "0.npz") as file:
            np.testing.assert_array_equal(file["depth_mm"], expected)
    swapped = table(two_lights, "a,b/rest.png", "b,a/rest.png")
    with pytest.raises(DataError, match="begun with something else: the background"):
        run_batch(two_lights, cal, tmp_path / "own", background=swapped)


def test_a_table_that_names_one_file_for_all_is_that_file(two_lights, cal, tmp_path):
    one = two_lights / "a/rest.png"
    run_batch(two_lights, cal, tmp_path / "one", background=one)
    run_batch(
        two_lights,
        cal,
        tmp_path / "both",
        background=table(two_lights, "a,a/rest.png", "b,a/rest.png"),
        table="csv",
    )
    kept = [tmp_path / name / "frames/b/0.npz" for name in ("one", "both")]
    assert kept[0].read_bytes() == kept[1].read_bytes()
    digests = [read_manifest(tmp_path / name).background_digest for name in ("one", "both")]
    assert all(digests)


def test_refused_before_anything_is_written(two_lights, cal, tmp_path):
    for rows, said in [
        (["a,a/rest.png"], "has no row for 'b'"),
        (["a,a/rest.png", "b,b/rest.png", "c,a/rest.png"], "the input lacks, 'c'"),
        (["a,a/rest.png", "b,b/none.png"], "The background .*none.png"),
        (["a,a/rest.png", "a,b/rest.png"], "each sequence once"),
        (["a"], "columns sequence and background"),
        ([], "columns sequence and background"),
    ]:
        with pytest.raises(DataError, match=said):
            run_batch(two_lights, cal, tmp_path / "out", background=table(two_lights, *rows))
        assert not (tmp_path / "out").exists()


def test_a_table_that_is_not_there(tmp_path):
    with pytest.raises(DataError, match="Cannot read the table"):
        backgrounds_of(tmp_path / "none.csv")
