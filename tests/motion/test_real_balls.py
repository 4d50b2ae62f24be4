"""Presses of a real ball on a GelSight Mini, by the starter: its center moves as the circles say, its turns are blind."""

import csv
from itertools import pairwise

import numpy as np
import pytest

import gelform
from gelform.calibration.starters import load_starter
from gelform.motion.between import FOUND
from gelform.motion.rigid import moved

MM_PER_PX, RADIUS_MM = 0.0634, 6.31 / 2
PRESSES = [13, 14, 15, 18, 19, 20, 21]  # whole circles, 2 to 3 mm apart


@pytest.fixture(scope="module")
def presses(data):
    """Results and places (mm from the middle) of some presses, by the circles that are kept for scoring."""
    folder = data / "mini-ball"
    background = gelform.read_image(folder / "background.png").astype(np.float32)
    starter = load_starter("gelsight-mini").for_unit(background, mm_per_px=MM_PER_PX)
    reconstruct = gelform.Reconstructor(starter)
    with (folder / "reference_circles.csv").open() as file:
        circles = {
            row["image"]: (float(row["center_x_px"]), float(row["center_y_px"]))
            for row in csv.DictReader(file)
        }
    names = [f"6.310mm/{k}/gelsight.png" for k in PRESSES]
    middle = (np.array(background.shape[1::-1]) - 1) / 2
    return [
        (
            reconstruct.from_image(gelform.read_image(folder / name)),
            (np.array(circles[name]) - middle) * MM_PER_PX,
        )
        for name in names
    ]


@pytest.mark.slow
def test_a_ball_is_found_and_does_not_turn(presses):
    errors, blind = [], []
    for (a, before), (b, after) in pairwise(presses):
        start = np.eye(4)
        start[:2, 3] = after - before + (0.1, -0.05)
        found = gelform.motion_between(a, b, start=start)
        assert found.state == FOUND, found.why
        center = np.array([*before, a.peak_mm - RADIUS_MM])
        errors.append(np.linalg.norm(moved(found.pose, center)[:2] - after))
        blind += [one.words.startswith("turns about the ball's center") for one in found.blind]
        assert np.degrees(np.sqrt(np.diag(found.covariance)[3:])).min() > 5
        assert np.abs(found.pose[:3, :3] - np.eye(3)).max() < 0.01
    assert np.mean(blind) > 0.8
    assert len(blind) == 3 * len(errors)
    assert np.median(errors) < 1.01 * 0.0766
    assert max(errors) < 1.01 * 0.170
