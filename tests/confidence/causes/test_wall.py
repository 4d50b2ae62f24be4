"""Wall: slopes that change faster than a ball's; a ball's own do not."""

import numpy as np
import pytest

from gelform.ball import ball_gradients
from gelform.color_models._shared.gamut import Gamut
from gelform.confidence.causes import wall
from gelform.confidence.causes.seen import BEND, BEND_FROM
from made.seen_frames import SHAPE, limits, seen

KNOWN = limits(gamut=Gamut(np.zeros((2, 2, 2), np.float32), np.zeros(3, np.float32), 0.1, 1.5))


def test_a_wall_two_pixels_wide():
    slopes = np.zeros((*SHAPE, 2), np.float32)
    slopes[:, 30:32, 0] = 0.8
    found = wall.sigma(seen(gradients=slopes, of=KNOWN))
    one_side = BEND * (0.8 / np.sqrt(2) - BEND_FROM)
    both = BEND * (0.8 - BEND_FROM)
    np.testing.assert_allclose(
        found[5, 27:35], [0, *[one_side] * 2, *[both] * 2, *[one_side] * 2, 0], rtol=1e-5
    )
    assert not found[:, :28].any()
    assert not found[:, 34:].any()


@pytest.mark.parametrize("radius_px", [40.0, 60.0])
def test_a_ball_is_no_wall_up_to_its_rim(radius_px):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    slopes = ball_gradients(x, y, (36.0, 20.0), radius_px).astype(np.float32)
    found = wall.sigma(seen(gradients=slopes, of=KNOWN))
    assert not found[np.hypot(x - 36, y - 20) < 0.4 * radius_px].any()


def test_nothing_without_training_presses():
    slopes = np.random.default_rng(0).normal(0, 1, (*SHAPE, 2)).astype(np.float32)
    assert not wall.sigma(seen(gradients=slopes)).any()
