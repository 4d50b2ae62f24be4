"""A flow knows its displacements in pixels and mm, says them, and comes back from the arrays of a file."""

import json

import numpy as np

from gelform.image.markers import MarkerFlow

REST = np.array([[10, 10], [30, 10], [50, 10]], dtype=np.float32)
MOVED = np.array([[0, 0], [3, 4], [-6, 8]], dtype=np.float32)


def flow(mm_per_px=0.05, seen=(True, True, False)):
    sigma = np.array([0.02, 0.03, 4.0], dtype=np.float32)
    return MarkerFlow(REST, REST + MOVED, np.array(seen), sigma, mm_per_px)


def test_displacements_in_pixels_and_mm():
    np.testing.assert_array_equal(flow().displacement_px, MOVED)
    np.testing.assert_allclose(flow().displacement_mm, 0.05 * MOVED)
    np.testing.assert_allclose(flow((0.1, 0.2)).displacement_mm, MOVED * [0.1, 0.2])
    np.testing.assert_allclose(flow((0.1, 0.2)).sigma_mm, [0.004, 0.006, 0.8])
    assert flow(None).displacement_mm is None
    assert flow(None).sigma_mm is None


def test_words_count_what_is_seen():
    assert flow().in_words() == "2 of 3 seen, moved 0.125 mm (median), 0.250 mm at most"
    assert flow(None).in_words() == "2 of 3 seen, moved 2.500 px (median), 5.000 px at most"
    assert flow(seen=(False,) * 3).in_words() == "none of 3 seen"
    assert "2 of 3" in repr(flow())


def test_facts_are_json():
    facts = json.loads(json.dumps(flow().facts()))
    assert facts["displacement_px"][1] == [3, 4]
    assert facts["seen"] == [True, True, False]
    assert json.loads(json.dumps(flow(None).facts()))["displacement_mm"] is None
