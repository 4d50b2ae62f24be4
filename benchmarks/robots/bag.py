"""ROS 2 bags: writing rate, and whether an independent reader finds the same values.

The rate is that of one core: frames per second of this process's processor time, which other processes do not change. The
rate by the clock is given too. The system's cache takes the bytes, so disks play no role.
"""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gelform.exchange.exporters.surface import points_from_result
from gelform.image.view import Frame
from gelform.reconstruct import Reconstructor
from gelform.result import Reconstruction
from gelform.robots.send import BagFile
from gelform.robots.topics import TOPICS
from gelform.simulate import LAYOUTS, Ball, Pose, simulate_ball_presses, simulate_pose

SENSOR = replace(LAYOUTS["three-edges"], shape=(240, 320))
ASKED_HZ, START_NS = 60, 1_700_000_000_000_000_000
DIFFERENT = 12  # different frames, which repeat
M_PER_MM = np.float32(1e-3)


def reconstructor() -> Reconstructor:
    """A Reconstructor of a simulated sensor of 240x320."""
    from gelform.calibration.fit import calibrate
    from gelform.calibration.presses.folder import read_presses
    from gelform.exchange.exporters.press_folder import save_simulated_presses

    rng = np.random.default_rng(0)
    made = simulate_ball_presses(SENSOR, ball_diameters_mm=[5, 8], count=10, rng=rng, oversample=1)
    with tempfile.TemporaryDirectory() as folder:
        presses = read_presses(save_simulated_presses(Path(folder) / "presses", made))
    return Reconstructor(calibrate(presses, color_model="polynomial"))


def frames_and_results(reconstruct: Reconstructor) -> list[tuple[Frame, Reconstruction]]:
    """A ball pressed deeper and deeper."""
    rng, pairs = np.random.default_rng(1), []
    for k in range(DIFFERENT):
        image = simulate_pose(SENSOR, Ball(3.0), Pose(0.05 * k), rng=rng).image
        frame = Frame(image, k / ASKED_HZ, START_NS + k * 10**9 // ASKED_HZ, k)
        pairs.append((frame, reconstruct(frame)))
    return pairs


def written(pairs: list[tuple[Frame, Reconstruction]], count: int, topics: tuple[str, ...]) -> dict[str, Any]:
    """Frames per second into a bag of those topics, with prepared results in memory."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        busy, clock = time.process_time(), time.perf_counter()
        with BagFile(path, "gel", topics=topics) as bag:
            for k in range(count):
                bag.write(*pairs[k % len(pairs)], START_NS + k * 10**9 // ASKED_HZ)
        busy, clock = time.process_time() - busy, time.perf_counter() - clock
        size = sum(file.stat().st_size for file in path.iterdir())
    return {
        "topics": list(topics),
        "frames": count,
        "rate_hz_of_a_core": count / busy,
        "rate_hz_by_the_clock": count / clock,
        "mb_per_frame": size / count / 1e6,
        "load_average": os.getloadavg()[0],
    }


def read_back(pairs: list[tuple[Frame, Reconstruction]]) -> dict[str, Any]:
    """Number of values that mcap-ros2-support decodes differently from those written; 0 is right."""
    from mcap_ros2.reader import read_ros2_messages

    different, compared, counts = 0, 0, dict.fromkeys(("image_raw", "indentation", "points"), 0)
    with tempfile.TemporaryDirectory() as folder:
        with BagFile(Path(folder) / "bag", "gel") as bag:
            for frame, result in pairs:
                bag.write(frame, result, frame.wall_time_ns)
        for message in read_ros2_messages(str(Path(folder) / "bag" / "bag.mcap")):
            name = message.channel.topic.rpartition("/")[2]
            if name not in counts:
                continue
            frame, result = pairs[counts[name]]
            wanted = _wanted(name, frame, result)
            got = np.frombuffer(bytes(message.ros_msg.data), wanted.dtype)
            same = (got == wanted) | (np.isnan(got) & np.isnan(wanted))
            different += int(np.count_nonzero(~same)) + (message.log_time_ns != frame.wall_time_ns)
            compared += got.size
            counts[name] += 1
    assert set(counts.values()) == {len(pairs)}, counts
    return {"values": compared, "different": different}


def _wanted(name: str, frame: Frame, result: Reconstruction) -> Any:
    """The values of a message, flat, computed without the writer."""
    if name == "image_raw":
        return frame.image.ravel()
    if name == "indentation":
        return np.where(result.known, result.depth_mm * M_PER_MM, np.float32(np.nan)).ravel()
    points = np.where(
        result.known.ravel()[:, None], points_from_result(result) * M_PER_MM, np.float32(np.nan)
    )
    return points.ravel()


def measure(reconstruct: Reconstructor, quick: bool) -> dict[str, Any]:
    """All figures."""
    pairs, count = frames_and_results(reconstruct), 60 if quick else 300
    return {
        "all_topics": written(pairs, count, tuple(TOPICS)),
        "without_points": written(pairs, count, ("image", "indentation", "diagnostics")),
        "read_back": read_back(pairs),
    }


def rows(figures: dict[str, Any]) -> list[tuple[str, Any, Any]]:
    """(figure, required, measured)."""
    whole, fewer, again = figures["all_topics"], figures["without_points"], figures["read_back"]
    return [
        ("bag, all topics, 240x320: frames a second of one core", ASKED_HZ, whole["rate_hz_of_a_core"]),
        ("the same by the clock", "-", whole["rate_hz_by_the_clock"]),
        ("MB a frame", "-", whole["mb_per_frame"]),
        ("without points: frames a second of one core", ASKED_HZ, fewer["rate_hz_of_a_core"]),
        (f"mcap-ros2-support: values that differ, of {again['values']}", 0, again["different"]),
    ]
