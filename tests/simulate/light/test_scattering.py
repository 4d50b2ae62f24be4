"""Light that spreads in the gel and bounces."""

import numpy as np
import pytest

from gelform.simulate import Coating
from gelform.simulate.light.scattering import spread_in_gel


def test_scattering_keeps_the_light_and_interreflection_adds_to_it():
    rng = np.random.default_rng(0)
    light = np.zeros((96, 128, 3))
    light[40:50, 60:70] = rng.uniform(50, 100, (10, 10, 3))
    scattered = spread_in_gel(light, Coating(scattering=0.5, scattering_mm=0.4), 0.1)
    assert scattered.sum() == pytest.approx(light.sum(), rel=0.01)
    assert scattered.max() < light.max()
    bounced = spread_in_gel(light, Coating(interreflection=0.2, interreflection_mm=1.0), 0.1)
    assert bounced.sum() == pytest.approx(1.2 * light.sum(), rel=0.01)
