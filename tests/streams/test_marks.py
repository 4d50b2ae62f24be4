"""Small parts that differ and stay so: scratch, dust, tear; and not what comes and goes or rests there."""

import numpy as np
import pytest

from gelform.streams.background_drift import Evidence
from gelform.streams.marks import Marks
from stream.sensor_faults import dust, scratch, tear

SHAPE = (160, 200)
REST = np.full((*SHAPE, 3), 100.0)


def marks_in(images, contact=None):
    marks, rng, ones = Marks(), np.random.default_rng(0), np.ones((*SHAPE, 3), np.float32)
    nowhere = np.zeros(SHAPE, bool)
    found = ()
    for image in images:
        noisy = (image + rng.normal(0, 0.2, image.shape)).astype(np.float32)
        start = REST.astype(np.float32)
        found = marks(Evidence(noisy, start, ones, nowhere, nowhere if contact is None else contact))
    return [finding.name for finding in found]


@pytest.mark.parametrize("fault", [scratch, dust, tear])
def test_each_is_named_when_it_stays(fault):
    marked = fault(REST, np.random.default_rng(8))
    assert marks_in([REST, marked, marked]) == []
    assert marks_in([REST, marked, marked, marked]) == [fault.__name__]


def test_what_comes_and_goes_is_no_mark():
    marked = dust(REST, np.random.default_rng(8))
    assert marks_in([marked, marked, REST, marked, marked]) == []


def test_what_rests_there_is_no_mark():
    """A scratch within a wide contact is the relief of what touches."""
    marked = scratch(REST, np.random.default_rng(8))
    assert marks_in([marked] * 4, contact=np.ones(SHAPE, bool)) == []


def test_the_ragged_edge_of_what_rests_there_is_no_mark():
    """A body's contact ends in thin parts, farther from where it is wide than a mark's surroundings."""
    groove = scratch(REST, np.random.default_rng(8))
    y, x = np.nonzero(groove.mean(axis=-1) != 100)
    body = np.zeros(SHAPE, bool)
    body[:, : x.min() - 40] = True
    body[y.min() : y.max() + 1 : 3, x.min() - 40 : x.min() + 1] = True  # narrow tongues that reach it
    assert marks_in([groove] * 4, contact=np.zeros(SHAPE, bool)) == ["scratch"]
    assert marks_in([groove] * 4, contact=body) == []


def test_a_sound_gel():
    assert marks_in([REST] * 5) == []


def test_a_short_groove_is_a_scratch_and_a_short_dark_spot_is_none():
    """Both 20 px long and about 8 wide: the groove is bright on one side and dark on the other."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    along, across = np.clip((10 - np.abs(x - 90)) / 2, 0, 1), (y - 70) / 2.2
    groove = 0.2 * along * across * np.exp(0.5 - across**2 / 2)
    spot = -0.2 * along * np.exp(-(across**4) / 10)
    marked = {name: REST * (1 + shape[..., None]) for name, shape in (("scratch", groove), ("dust", spot))}
    assert {name: marks_in([image] * 4) for name, image in marked.items()} == {
        "scratch": ["scratch"],
        "dust": ["dust"],
    }
