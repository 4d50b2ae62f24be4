"""The simulated frame source: rate, pose, dropped frames."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.frames import Frame
from gelform.sensors.simulated.moved import SimulatedSource
from gelform.simulate import LAYOUTS, Coating, Cylinder, Timing

SENSOR = replace(LAYOUTS["three-edges"], shape=(60, 80), mm_per_px=0.2, timing=Timing(frame_rate_hz=20.0))


class Clock:
    """A clock that only sleep moves."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


def source(sensor=SENSOR, **settings):
    clock = Clock()
    return SimulatedSource(sensor, clock=clock, sleep=clock.sleep, **settings), clock


def test_frames_come_at_the_frame_rate():
    camera, clock = source()
    frames = [camera.read() for _ in range(5)]
    assert all(isinstance(frame, Frame) for frame in frames)
    assert [frame.index for frame in frames] == [0, 1, 2, 3, 4]
    assert clock.now == pytest.approx(100.0 + 4 / 20)
    assert np.diff([frame.time_s for frame in frames]) == pytest.approx(0.05)


def test_a_late_reader_gets_the_latest_frame_and_sees_the_gap():
    camera, clock = source()
    camera.read()
    clock.now += 0.52
    assert camera.read().index == 10


def test_moving_the_indenter_shows_in_the_next_frame():
    camera, _ = source()
    rest = camera.read().image.astype(float)
    camera.move(depth_mm=0.8, center_mm=(2.0, 1.0))
    pressed = camera.read().image.astype(float)
    assert camera.truth is not None
    contact = camera.truth.contact
    assert contact.any()
    assert np.abs(pressed - rest)[contact].mean() > 5 * np.abs(pressed - rest)[:10, :10].mean()
    camera.move(depth_mm=0.0)
    camera.read()
    assert not camera.truth.contact.any()


def test_another_indenter_starts_off_the_gel():
    camera, _ = source()
    camera.move(depth_mm=0.5)
    camera.press_with(Cylinder(2, 6))
    camera.read()
    assert not camera.truth.contact.any()


def test_a_bad_pose_leaves_the_indenter_where_it_was():
    camera, _ = source()
    camera.move(depth_mm=0.5)
    with pytest.raises(ValueError, match="gel's 3 mm"):
        camera.move(depth_mm=3.5)
    with pytest.raises(ValueError, match="finite"):
        camera.move(center_mm=(np.nan, 0))
    assert camera.pose.depth_mm == 0.5


def test_dropped_frames_leave_gaps_in_the_index():
    camera, _ = source(replace(SENSOR, timing=Timing(frame_rate_hz=20.0, drop_probability=0.5)))
    gaps = np.diff([camera.read().index for _ in range(40)])
    assert gaps.min() == 1
    assert 5 < np.count_nonzero(gaps > 1) < 35


def test_the_surface_is_dragged_from_frame_to_frame():
    camera, _ = source(replace(SENSOR, coating=Coating(marker_pitch_mm=1.0)))
    camera.move(depth_mm=0.6)
    camera.read()
    still = camera.truth.markers_shift_mm
    camera.move(center_mm=(0.1, 0.0))
    camera.read()
    moved = camera.truth.markers_shift_mm - still
    assert moved[:, 0].max() > 0.05


def test_the_background_is_an_untouched_frame():
    camera, _ = source()
    frame = camera.read().image.astype(float)
    apart = camera.background.astype(float) - frame
    assert abs(apart.mean()) < 0.1
    assert 0.3 < apart.std() < 4


def test_frames_drift_with_the_clock_of_the_camera():
    camera, _ = source(
        replace(SENSOR, noise_sd=0, noise_gain=0, timing=Timing(5.0, drift=(0.3, 0, 0), drift_time_s=1.0))
    )
    first, second = camera.read(), camera.read()
    expected = 1 + 0.3 * (1 - np.exp(-0.2))
    ratio = second.image[..., 0].mean() / first.image[..., 0].mean()
    assert ratio == pytest.approx(expected, rel=0.01)


def test_the_same_seed_gives_the_same_frames():
    images = [[camera.read().image for _ in range(2)] for camera in (source(seed=3)[0], source(seed=3)[0])]
    np.testing.assert_array_equal(images[0], images[1])
    assert np.any(images[0][0] != source(seed=4)[0].read().image)
