"""Videos come back as the frames that were written, and what is wrong with one is said."""

import cv2
import numpy as np
import pytest

import gelform
from gelform.sensors.video_files import is_video


def write(path, frames, codec="FFV1"):
    """Frames (RGB) as a video of 25 Hz; FFV1 loses nothing but needs a picture format it knows."""
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 25.0, (width, height))
    assert writer.isOpened()
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
    writer.release()


@pytest.fixture
def frames():
    """Smooth, coloured, no two alike."""
    y, x = np.mgrid[0:48, 0:64]
    return [
        np.stack([2 * x + k, 3 * y, 200 - 2 * x - k], axis=-1).clip(0, 255).astype(np.uint8)
        for k in range(12)
    ]


def test_frames_are_rgb_in_order_with_times(tmp_path, frames):
    write(tmp_path / "a.avi", frames, "MJPG")
    video = gelform.Video(tmp_path / "a.avi")
    read = list(video)
    assert [frame.index for frame in read] == list(range(12))
    np.testing.assert_allclose([frame.time_s for frame in read], np.arange(12) / 25, atol=1e-3)
    for frame, true in zip(read, frames):
        assert np.abs(frame.image.astype(int) - true).mean() < 4
    assert video.facts.shape == (48, 64)
    assert video.facts.frame_rate_hz == pytest.approx(25)
    assert video.facts.count == 12


def test_a_video_is_read_again_and_in_part(tmp_path, frames):
    write(tmp_path / "a.avi", frames, "MJPG")
    video = gelform.Video(tmp_path / "a.avi")
    first = list(video)
    part = list(video.frames({3, 7}))
    assert [frame.index for frame in part] == [3, 7]
    for frame in part:
        np.testing.assert_array_equal(frame.image, first[frame.index].image)
        assert frame.time_s == first[frame.index].time_s


def test_no_file_empty_file_and_no_video(tmp_path):
    with pytest.raises(gelform.DataError, match="No video file"):
        gelform.Video(tmp_path / "nothing.avi")
    (tmp_path / "empty.avi").touch()
    with pytest.raises(gelform.DataError, match="is empty"):
        gelform.Video(tmp_path / "empty.avi")
    (tmp_path / "text.avi").write_text("no video " * 100)
    with pytest.raises(gelform.DataError, match="cannot be decoded"):
        gelform.Video(tmp_path / "text.avi")


def test_truncated_video(tmp_path, frames):
    path = tmp_path / "a.avi"
    write(path, frames, "MJPG")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(gelform.DataError, match=r"truncated or damaged|cannot be decoded"):
        list(gelform.Video(path))


def test_names_of_videos():
    assert is_video("presses.MP4")
    assert not is_video("presses.png")
