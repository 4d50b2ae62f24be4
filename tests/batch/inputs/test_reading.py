"""Frames of folders, videos and recordings; what cannot be read says why, and the others come."""

import numpy as np
import pytest

from gelform.batch.inputs.listing import listing_of
from gelform.batch.inputs.plan import plan_of
from gelform.batch.inputs.reading import background_of_sequence, frames_of_part, image_of_calibration
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
