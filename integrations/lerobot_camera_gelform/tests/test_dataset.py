"""A dataset that LeRobot writes and reads: depth to a micrometer, at 30 Hz; LeRobot's default color is lossy."""

import os

import pytest
from lerobot_camera_gelform import lossless_rgb_encoder
from record import RATE_HZ, measured


@pytest.fixture(scope="module")
def figures():
    return measured(5.0, lossless_rgb_encoder())


def test_depth_comes_back_to_a_micrometer(figures):
    assert figures["deepest_mm"] > 0.3  # something was pressed
    assert figures["depth_rms_um"] < 1
    assert figures["depth_worst_um"] < 3


def test_five_seconds_at_thirty_frames_a_second_without_a_timeout(figures):
    assert figures["frames"] == 5 * RATE_HZ
    if (load := os.getloadavg()[0]) > os.cpu_count():
        pytest.skip(f"the machine is busy, load {load:.1f}: {figures['rate_hz']:.1f} Hz")
    assert figures["timeouts"] == 0
    assert figures["rate_hz"] == pytest.approx(RATE_HZ, rel=0.1)


def test_color_comes_back_exactly_with_the_lossless_encoder_alone(figures):
    assert figures["color_worst_level"] == figures["color_slope_deg"] == 0
    lossy = measured(0.5)
    assert lossy["color_worst_level"] > 3
    assert lossy["color_slope_deg"] > 0.2
