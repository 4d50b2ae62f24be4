"""No depth beyond what the gel can do."""

import numpy as np
import pytest

from gelform.health import DepthLimit


def test_the_field_of_view_bounds_where_the_gel_is_unknown():
    limit = DepthLimit.of((240, 320), 0.05)
    assert limit.limit_mm == pytest.approx(12.0)
    assert not limit.is_thickness


def test_the_gels_thickness_goes_first():
    limit = DepthLimit.of((240, 320), 0.05, thickness_mm=3.5)
    assert limit.limit_mm == 3.5
    depth = np.array([[1.0, 4.0], [-9.0, 0.0]], dtype=np.float32)
    bounded, findings = limit.bound(depth)
    np.testing.assert_array_equal(bounded, [[1.0, 3.5], [-3.5, 0.0]])
    (finding,) = findings
    assert finding.name == "beyond_gel"
    assert finding.figure == 9.0
    assert "3.5 mm" in finding.message
    assert "gel is thick" in finding.message


def test_a_depth_within_is_left_as_it_is():
    depth = np.array([[0.0, 3.0]], dtype=np.float32)
    bounded, findings = DepthLimit(3.0, True).bound(depth)
    assert bounded is depth
    assert findings == ()


def test_not_to_know_is_to_expect_anything_within_the_limit():
    anything = np.random.default_rng(0).uniform(0, 6.0, 100_000)
    assert DepthLimit(6.0, True).ignorance_mm == pytest.approx(anything.std(), rel=0.01)
