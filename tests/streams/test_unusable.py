"""A frame that the Reconstructor refuses: nothing known, the reason said."""

import numpy as np
import pytest

from gelform.health import DepthLimit
from gelform.streams.unusable import NOT_THIS_GEL, result_from_image


@pytest.fixture
def foreign(at_rest):
    """The gel's image turned over: no gain makes one of the other."""
    return np.ascontiguousarray(at_rest[0][::-1, ::-1, [2, 0, 1]])


def test_nothing_is_known_and_the_refusal_is_a_finding(reconstruct, foreign):
    result = result_from_image(reconstruct, foreign)
    assert result.health[-1].name == NOT_THIS_GEL
    assert "background" in result.health[-1].message
    assert not result.known.any()
    assert not result.confidence.any()
    assert not result.contact.any()
    limit = DepthLimit.of(result.shape, result.mm_per_px).ignorance_mm
    assert result.depth_sigma_mm.min() == np.float32(limit)
    assert result.calibration_digest == reconstruct.calibration.digest


def test_any_other_image_passes_unchanged(reconstruct, pressed):
    result = result_from_image(reconstruct, pressed[0])
    np.testing.assert_array_equal(result.depth, reconstruct.from_image(pressed[0]).depth)


def test_an_image_of_another_size_is_refused(reconstruct, at_rest):
    with pytest.raises(ValueError, match="132"):
        result_from_image(reconstruct, at_rest[0][:-1])
