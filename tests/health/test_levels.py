"""Dark and saturated blocks."""

import numpy as np
import pytest

from gelform.health.levels import Levels
from made.worn_frames import blocks_of, constant, gel


def test_a_rest_image_that_is_dark_itself_says_nothing_of_darkness():
    dim = np.minimum(gel(), 12)
    assert Levels(blocks_of(dim))(blocks_of(constant(0))) == ((), None)


def test_a_rest_image_that_is_saturated_itself_says_nothing_of_saturation():
    assert Levels(blocks_of(constant(250)))(blocks_of(constant(255))) == ((), None)


@pytest.mark.parametrize(("level", "found"), [(7, ["dark"]), (9, []), (251, []), (253, ["saturated"])])
def test_the_levels_that_count(level, found):
    findings, blocks = Levels(blocks_of(gel()))(blocks_of(constant(level)))
    assert [finding.name for finding in findings] == found
    assert (blocks is not None) == bool(found)


def test_what_is_counted_elsewhere_is_left_out():
    levels = Levels(blocks_of(gel()))
    black = blocks_of(constant(0))
    torn = np.ones(black.means.shape[:2], dtype=bool)
    torn[:3] = False
    findings, blocks = levels(black, torn)
    assert findings[0].figure == pytest.approx(0.5)
    assert not blocks[3:].any()
