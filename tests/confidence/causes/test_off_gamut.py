"""Off gamut: the distance to the colours of the training presses, as a slope."""

import numpy as np

from gelform.color_models._shared.gamut import Gamut
from gelform.confidence.causes import off_gamut
from made.seen_frames import SHAPE, limits, seen


def test_the_distance_to_the_nearest_colour_that_was_seen():
    trained = np.random.default_rng(2).uniform(-0.3, 0.3, (20_000, 3)).astype(np.float32)
    gamut = Gamut.fit(trained, 2 * trained[:, :2])
    change = np.zeros((*SHAPE, 3), np.float32)
    change[5, 6] = 1.3, 0, 0
    found = off_gamut.sigma(seen(color_change=change, of=limits(gamut=gamut)))
    assert abs(found[5, 6] - 1.0 * gamut.slope_per_change) < 3 * gamut.bin_width * gamut.slope_per_change
    assert np.count_nonzero(found) == 1


def test_nothing_without_training_presses():
    assert not off_gamut.sigma(seen()).any()
