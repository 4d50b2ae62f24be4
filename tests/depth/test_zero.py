"""Where depth is 0, and what is leveled off."""

import numpy as np
import pytest

from gelform.depth.zero import fitted_surface, median_over, zero_region

pytestmark = pytest.mark.linear_algebra


def test_regions_by_name_and_by_map():
    assert zero_region("mean", (4, 5)).all()
    border = zero_region("border", (4, 5))
    assert border.sum() == 20 - 6
    assert not border[1:-1, 1:-1].any()
    assert zero_region("border", (2, 5)).all()
    own = np.eye(4, dtype=bool)
    np.testing.assert_array_equal(zero_region(own, (4, 4)), own)
    with pytest.raises(ValueError, match="'mean', 'border' or a boolean"):
        zero_region("middle", (4, 4))


def test_the_median_of_a_large_region_is_nearly_that_of_all():
    rng = np.random.default_rng(0)
    maps = rng.normal(3, 1, (2, 300, 400)).astype(np.float32)
    region = rng.random((300, 400)) < 0.7
    np.testing.assert_allclose(median_over(maps, region), [np.median(one[region]) for one in maps], atol=0.05)
    small = np.zeros_like(region)
    small[5, 3:8] = True
    np.testing.assert_array_equal(median_over(maps, small), np.median(maps[:, small], axis=-1))


@pytest.mark.parametrize("degree", [1, 2])
def test_a_polynomial_surface_is_found_exactly(degree):
    y, x = np.mgrid[:20, :30] / 10.0
    surface = 1 + 0.3 * x - 0.2 * y + (degree == 2) * (0.1 * x * y - 0.05 * y**2)
    region = np.zeros((20, 30), dtype=bool)
    region[::3, ::4] = True
    spoiled = np.where(region, surface, 99.0)
    np.testing.assert_allclose(fitted_surface(spoiled, region, degree), surface, atol=1e-5)
    with pytest.raises(ValueError, match="zero pixels to fit a surface, got 1"):
        fitted_surface(spoiled, np.arange(600).reshape(20, 30) == 7, degree)
