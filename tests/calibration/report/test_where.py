"""Errors by slope and place: an error put into one part of the samples is found there and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.report.where import errors_where
from gelform.metrics import angle_deg

SHAPE = (60, 80)
CIRCLE = (40.0, 30.0, 25.0)


def with_errors(sample, mask, gain=0.7):
    gradients = np.where(mask[:, None], gain * sample.true_gradients, sample.true_gradients)
    return replace(sample, gradients=gradients.astype(np.float32))


def rho(sample):
    return np.hypot(sample.x_px - CIRCLE[0], sample.y_px - CIRCLE[1]) / CIRCLE[2]


def test_a_flat_rim_is_up_to_the_rim_and_not_inside_the_edge(sample):
    one = sample(0, circle=CIRCLE)
    flat = with_errors(one, rho(one) >= 0.8)
    where = errors_where([flat], SHAPE, 0.8)
    expected = angle_deg(flat.gradients, flat.true_gradients)
    assert where["contact_radius_ratio"] == 0.8
    assert where["contact"]["normal_deg"] == pytest.approx(0, abs=1e-4)
    assert where["rim"]["normal_deg"] == pytest.approx(expected.mean(), rel=1e-6)
    assert expected.mean() > 1
    steep = where["rim"]["by_slope"][-1]
    assert steep["gain"] == pytest.approx(0.7, abs=1e-5)
    assert steep["slope_from"] >= 0.6 > where["contact"]["by_slope"][-1]["slope_from"]
    assert all(b["gain"] == pytest.approx(1, abs=1e-5) for b in where["contact"]["by_slope"])
    part = errors_where([flat], SHAPE, 0.9)["contact"]["normal_deg"]
    assert part == pytest.approx(expected[rho(one) < 0.9].mean(), rel=1e-5), "the edge says what is counted"


def test_errors_stand_in_the_slope_bin_that_has_them(sample):
    one = sample(0, circle=CIRCLE)
    gentle = with_errors(one, one.true_slope < 0.2, gain=1.3)
    for b in errors_where([gentle], SHAPE, 1.0)["contact"]["by_slope"]:
        assert b["gain"] == pytest.approx(1.3 if b["slope_to"] <= 0.2 else 1.0, abs=1e-5)
        assert (b["normal_deg"] > 0.1) == (b["slope_to"] <= 0.2)


def test_errors_stand_in_the_place_that_has_them(sample):
    left, right = sample(0, circle=(20.0, 30.0, 18.0)), sample(1, circle=(60.0, 30.0, 18.0), gain=0.8)
    place = errors_where([left, right], SHAPE, 1.0, (1, 2))["contact"]["by_place"]
    assert place["pixels"] == [len(left.x_px), len(right.x_px)]
    assert place["normal_deg"][0] == pytest.approx(0, abs=1e-4)
    assert place["normal_deg"][1] == pytest.approx(right.normal_deg, rel=1e-5)
    assert right.normal_deg > 1
    assert errors_where([left], SHAPE, 1.0, (1, 2))["contact"]["by_place"]["normal_deg"][1] is None
