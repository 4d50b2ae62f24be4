"""The light against that of the start: brighter, coloured, or added from outside."""

import numpy as np
import pytest

from gelform.streams.evidence import Evidence
from gelform.streams.health.light import light_findings, room_light_finding

SHAPE = (96, 128)


def named(gains):
    return {finding.name: finding.figure for finding in light_findings(np.array(gains))}


def test_the_light_of_the_start_is_no_finding():
    assert named([1.0, 1.02, 0.99]) == {}


def test_all_channels_alike_are_brightness():
    assert named([0.8, 0.8, 0.8]) == {"brightness_shift": pytest.approx(-0.2)}


def test_one_channel_is_colour():
    assert named([1.0, 1.06, 1.0]) == {"color_shift": pytest.approx(0.06)}


def evidence(now, contact=None):
    nowhere = np.zeros(SHAPE, bool)
    start = rest()
    return Evidence(
        10.0,
        now.astype(np.float32),
        10,
        start,
        np.ones_like(start),
        nowhere,
        nowhere if contact is None else contact,
    )


def rest():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / SHAPE[1]
    return np.stack([40 + 90 * x, 120 - 60 * y, 60 + 60 * x * y], axis=-1).astype(np.float32)


def noise(seed=0):
    return np.random.default_rng(seed).normal(0, 0.5, (*SHAPE, 3))


def test_light_from_outside_is_added_in_every_channel():
    (found,) = room_light_finding(evidence(0.97 * rest() + 10 + noise()))
    assert found.name == "room_light"
    assert 6 < found.figure <= 10.5  # at least so much: three standard deviations are taken off


@pytest.mark.parametrize("gain", [0.75, 1.0, 1.3])
def test_the_sensors_own_light_is_none(gain):
    assert room_light_finding(evidence(gain * rest() + noise())) == ()


def test_one_channel_alone_is_none():
    assert room_light_finding(evidence(rest() + np.array([15, 0, 0]) + noise())) == ()


def test_what_touches_does_not_count():
    now, contact = rest() + noise(), np.zeros(SHAPE, bool)
    now[:, 40:] += 30
    contact[:, 40:] = True
    assert room_light_finding(evidence(now, contact)) == ()
    assert room_light_finding(evidence(now, np.ones(SHAPE, bool))) == ()
