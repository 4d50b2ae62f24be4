"""Marker: what dots hide says nothing."""

import numpy as np

from gelform.confidence.causes import marker
from made.seen_frames import patch, seen


def test_where_the_dots_are():
    frame = seen(markers=patch())
    assert np.array_equal(marker.sigma(frame), np.where(patch(), np.float32(frame.limits.unseen), 0))
    assert not marker.sigma(seen()).any()
