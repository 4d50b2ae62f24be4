"""The picture of an explanation: a panel for each cause that is there, and the place of a fault in it."""

import numpy as np
import pytest

from gelform.confidence.causes import CAUSES
from gelform.confidence.explanation import explanation_of

pytest.importorskip("matplotlib", reason="matplotlib, the extra `plots`, is not installed")
from gelform.plots.explanation import COLORS, explanation_picture

SHAPE = (40, 72)


def explained(*causes):
    """Of a frame in which some causes, if any, leave nothing of a patch."""
    sigma, patch = np.full(SHAPE, 0.03, np.float32), np.zeros(SHAPE, np.float32)
    patch[10:20, 30:44] = 40
    maps = {name: patch if name in causes else 0 * patch for name in CAUSES}
    sigma = np.hypot(sigma, patch if causes else 0)
    return explanation_of(maps, sigma, np.minimum(1, (0.04 / sigma) ** 2), 0.04)


def test_each_cause_that_is_there_has_a_panel():
    image = np.full((*SHAPE, 3), 100, np.uint8)
    without = explanation_picture(explained(), image)
    one = explanation_picture(explained("marker"), image)
    assert one.shape[0] > without.shape[0]
    assert one.shape[1] == without.shape[1]


def test_every_cause_has_a_colour():
    assert len(COLORS) == len(set(COLORS)) == 1 + len(CAUSES)


def test_an_image_of_another_size_is_refused():
    with pytest.raises(ValueError, match="40x72"):
        explanation_picture(explained(), np.zeros((8, 8, 3), np.uint8))
