"""What the door asks of arrays at the speed of memory."""

import numpy as np
import pytest

from gelform import depth
from kernel_agreement import assert_kernel_agrees


@pytest.mark.parametrize("shape", [(1,), (15, 3), (40, 33, 2)])
def test_magnitude_is_that_of_numpy(shape):
    values = np.random.default_rng(0).standard_normal(shape).astype(np.float32)
    for largest in (-7.5, 9.0):
        values.ravel()[-1] = largest
        assert_kernel_agrees(
            depth._magnitude,
            lambda v, _: np.abs(v).max(keepdims=True).ravel(),
            values,
            np.zeros(1, np.float32),
        )
