"""Modified Bessel functions against scipy."""

import numpy as np
import pytest
from scipy import special

from gelform.foundations.bessel import bessel_k


@pytest.mark.parametrize("order", [0, 1])
def test_it_is_that_of_scipy(order):
    x = np.geomspace(1e-4, 15, 500)
    np.testing.assert_allclose(bessel_k(order, x), special.kv(order, x), rtol=1e-9)
