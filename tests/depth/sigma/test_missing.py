"""The depth that steep slopes may miss: what a face's slopes add up to, and what is said of the object."""

import numpy as np
import pytest

from gelform.depth.sigma.missing import DOUBTED, MissingDepth, at_least
from gelform.depth.sigma.sigma import DepthDifference

SHAPE, PITCH = (96, 160), 0.1
STEEP = 0.4


def roof(slope, half_px=20):
    """Slopes (H, W, 2) of a roof across the rows, the deviation of its faces, and the pixels beside it."""
    y = np.mgrid[: SHAPE[0], : SHAPE[1]][0] - (SHAPE[0] - 1) / 2
    face = np.abs(y) < half_px
    gradients = np.zeros((*SHAPE, 2), np.float32)
    gradients[..., 1] = np.where(face, -slope * np.sign(y), 0)
    return gradients, np.where(face, np.float32(STEEP), np.float32(0)), ~face


@pytest.mark.parametrize("slope", [0.5, -0.5])
def test_a_roof_misses_what_its_faces_add_up_to(slope):
    gradients, steep, rest = roof(slope)
    missing = MissingDepth(SHAPE, PITCH).of_slopes(gradients, steep, rest)
    assert missing[SHAPE[0] // 2].mean() == pytest.approx(np.sign(slope) * STEEP * 20 * PITCH, rel=0.1)
    np.testing.assert_allclose(missing[rest], 0, atol=0.05 * STEEP * 20 * PITCH)


class Prepared:
    """A standard deviation of 1 um of every difference."""

    def __call__(self, gradients_sigma, **settings):
        return np.full(SHAPE, 1e-3, np.float32)


def test_the_stated_deviations_contain_it():
    gradients, steep, rest = roof(0.5)
    depth = np.where(rest, 0, 1).astype(np.float32)
    depth[SHAPE[0] // 2] = 1.5
    known = DepthDifference(Prepared(), np.ones((*SHAPE, 2)), {}, depth, 0.0)
    frame = gradients, steep, None, rest, depth, np.full(SHAPE, 0.03, np.float32)
    sigma, difference, findings = MissingDepth(SHAPE, PITCH)(*frame, known)
    missing = MissingDepth(SHAPE, PITCH).of_slopes(gradients, steep, rest)
    np.testing.assert_allclose(sigma, np.hypot(0.03, missing), rtol=1e-5)
    along = np.zeros(SHAPE, bool)
    along[SHAPE[0] // 2] = True
    assert difference(along)[along].max() < 0.02, "the ridge is as high everywhere"
    assert difference(~rest)[along].min() > 0.2, "but not as high as its faces"
    assert [one.name for one in findings] == ["steep"]
    assert "at least 1.50 mm" in findings[0].message
    assert findings[0].figure == pytest.approx(missing[SHAPE[0] // 2].mean(), rel=0.05)


@pytest.mark.parametrize("share", [0.0, 0.99 * DOUBTED / STEEP])
def test_nothing_changes_where_slopes_are_hardly_doubted(share):
    gradients, steep, rest = roof(0.5)
    sigma = np.full(SHAPE, 0.03, np.float32)
    frame = (
        gradients,
        np.float32(share) * steep,
        np.zeros_like(steep),
        rest,
        np.zeros(SHAPE, np.float32),
        sigma,
    )
    known = DepthDifference(Prepared(), np.ones((*SHAPE, 2)), {}, frame[4], 0.0)
    stated = MissingDepth(SHAPE, PITCH)(*frame, known)
    assert [one is same for one, same in zip(stated, (sigma, known, ()))] == [True] * 3
    assert MissingDepth(SHAPE, PITCH)(*frame[:5], None, None) == (None, None, ())


def test_what_blur_may_take_from_walls_adds_up_however_small():
    gradients, steep, rest = roof(0.5)
    wall, depth = steep / 10, np.zeros(SHAPE, np.float32)
    known = DepthDifference(Prepared(), np.ones((*SHAPE, 2)), {}, depth, 0.0)
    stated = MissingDepth(SHAPE, PITCH)
    alone, _, _ = stated(gradients, 0 * steep, wall, rest, depth, np.full(SHAPE, 0.03, np.float32), known)
    np.testing.assert_allclose(alone, np.hypot(0.03, stated.of_slopes(gradients, wall, rest)), rtol=1e-5)
    both, _, _ = stated(gradients, steep, wall, rest, depth, np.full(SHAPE, 0.03, np.float32), known)
    of_both = stated.of_slopes(gradients, np.hypot(steep, wall), rest)
    np.testing.assert_allclose(both, np.hypot(0.03, of_both), rtol=1e-5)


def test_only_a_missing_depth_beyond_the_other_errors_is_said():
    assert at_least(1.0, 0.05, 0.14) == ()
    assert at_least(1.0, 0.05, 0.16)[0].figure == 0.16
