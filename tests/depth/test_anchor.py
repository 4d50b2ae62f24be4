"""What is held at rest: untouched gel, drifted gel too, but never the flat face of something pressed."""

import cv2
import numpy as np
import pytest
from scipy import ndimage

from gelform.depth import anchor as room
from gelform.depth.anchor import REACH_MM, REST_SIGMA_MM, RestAnchor
from gelform.depth.integrate import depth_from_gradients
from gelform.slopes.gradients import gradients_from_depth
from kernel_agreement import assert_kernel_agrees

SHAPE, PITCH, CLEAN = (120, 160), 0.1, 0.05


def away_from(x, y):
    """Distance of each pixel, px."""
    rows, columns = np.indices(SHAPE)
    return np.hypot(columns - x, rows - y)


def read(depth):
    """The gradients of a depth, and where their color is that of rest."""
    gradients = gradients_from_depth(depth, mm_per_px=PITCH).astype(np.float32)
    return gradients, np.linalg.norm(gradients, axis=-1) < 1e-3


def plateau(height_mm: float, radius_px: float = 22.0, center=(70, 60)):
    """A flat punch with sloping walls: its face has the slope, and so the color, of rest."""
    rho = away_from(*center)
    depth = height_mm * np.clip((radius_px + 6 - rho) / 6, 0, 1)
    return depth, *read(depth), rho < radius_px - 2


HOLD = (CLEAN * PITCH / REST_SIGMA_MM) ** 2
EVERYWHERE = np.ones(SHAPE, dtype=bool)


def anchored(*maps):
    return RestAnchor(SHAPE, PITCH, CLEAN)(*maps)


def test_untouched_gel_is_held_as_the_units_say():
    np.testing.assert_allclose(anchored(np.zeros((*SHAPE, 2), np.float32), EVERYWHERE), HOLD, rtol=1e-3)


@pytest.mark.parametrize("height_mm", [0.1, -0.1])
def test_gel_off_rest_that_the_border_cuts_is_held_as_drift(height_mm):
    """No rim encloses it: a ball's sink beyond the frame would count as pressed flat otherwise."""
    _, gradients, untouched, face = plateau(height_mm, radius_px=40, center=(0, 60))
    anchor = anchored(gradients, untouched)
    assert anchor[face & (away_from(0, 60) < 20)].mean() == pytest.approx(HOLD, rel=0.05)


def test_rest_is_where_most_is_untouched_not_where_most_pixels_are():
    """A press over most of the frame, and nowhere a whole coarse pixel of untouched color: 0 is still the gel's."""
    _, gradients, _, face = plateau(0.5, radius_px=75)
    outside = away_from(70, 60) > 84
    anchor = anchored(gradients, outside & (np.add(*np.indices(SHAPE)) % 2 == 0))
    assert outside.mean() < 0.3
    assert face.mean() > 0.6
    assert anchor[outside].max() > 0.8 * HOLD
    assert not anchor[face].any()


@pytest.mark.parametrize(
    ("height_mm", "radius_px", "share", "within"),
    [
        *((0.15, 22, 0.02, 0.03), (0.5, 22, 0.02, 0.03)),
        *((0.05, 10, 0.04, 0.01), (-0.05, 10, 0.04, 0.01), (0.1, 10, 0.04, 0.01)),
    ],
)
def test_a_flat_face_is_not_held(height_mm, radius_px, share, within):
    """Nor 2 mm wide: the rim that encloses it says that it is not at rest, although its color is."""
    _, gradients, untouched, face = plateau(height_mm, radius_px)
    anchor = anchored(gradients, untouched)
    assert untouched[face].all()
    assert not anchor[~untouched].any()
    assert anchor.min() >= 0
    assert anchor[face].max() < share * anchor[:5].mean()
    found = depth_from_gradients(gradients, mm_per_px=PITCH, anchor=anchor)
    assert found[face].mean() == pytest.approx(height_mm, rel=within)
    alike = untouched * np.float32(anchor[:5].mean())
    naive = depth_from_gradients(gradients, mm_per_px=PITCH, anchor=alike)
    assert abs(naive[face].mean()) < 0.8 * abs(height_mm)  # what color alone would have made of it


def test_gel_that_a_ring_encloses_at_rest_is_held():
    """Inside an O-ring the gel is where it was: enclosed, and no face."""
    rho = away_from(70, 60)
    anchor = anchored(*read(0.3 * np.clip(1 - np.abs(rho - 40) / 6, 0, 1)))
    assert anchor[rho < 10].mean() > 0.9 * HOLD


def test_gel_beside_touched_gel_is_hardly_held():
    """By 1 - exp(-(d/1 mm)^2) of the distance from what is touched: it is drawn down, by less than its color tells."""
    depth, gradients, untouched, _ = plateau(0.3)
    anchor = anchored(gradients, untouched)
    for beyond_px in (8, 16):
        ring = np.abs(away_from(70, 60) - 28 - beyond_px) < 0.7
        expected = 1 - np.exp(-((beyond_px * PITCH / REACH_MM) ** 2))
        assert not depth[ring].any()
        assert anchor[ring].mean() == pytest.approx(HOLD * expected, rel=0.25)
    assert anchor[:4].mean() > 0.99 * HOLD


def test_drift_is_taken_out():
    """Slopes that are wrong by a smooth field lift the far gel; the anchor holds it, the press stays."""
    depth, gradients, untouched, _ = plateau(0.4)
    gradients[..., 0] += 0.02 * np.linspace(-1, 1, SHAPE[1], dtype=np.float32)

    def off(hold):
        z = depth_from_gradients(gradients, mm_per_px=PITCH, anchor=hold, zero=untouched)
        return np.sqrt(np.mean((z - depth)[away_from(70, 60) > 45] ** 2))

    assert off(anchored(gradients, untouched)) < 0.75 * off(None)


@pytest.mark.parametrize("shape", [(1, 9), (9, 1), (7, 5), (61, 83), (3, 200), (200, 3)])
def test_any_shape(shape):
    gradients = np.zeros((*shape, 2), dtype=np.float32)
    anchor = RestAnchor(shape, PITCH, CLEAN)(gradients, np.ones(shape, dtype=bool))
    assert anchor.shape == shape
    assert np.isfinite(anchor).all()


def hold_by_scipy(depth, share, far, hold, least, face):
    """Of regions that share an edge; those that touched gel encloses are free where they are off rest in the mean."""
    rest = share >= min(least, share.max())
    z = depth.astype(np.float64) - np.median(depth[rest])
    weight = hold * (np.ones(depth.shape) if far is None else far)
    labels, count = ndimage.label(rest)
    border = np.ones(depth.shape, bool)
    border[1:-1, 1:-1] = False
    for label in range(1, count + 1):
        region = labels == label
        if not (region & border).any() and abs(z[region].mean()) > face:
            weight[region] = 0
    return weight


@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize("shape", [(21, 30), (1, 5), (7, 1)])
def test_the_hold_of_a_coarse_depth(shape, far):
    rng = np.random.default_rng(1)
    share = np.where(rng.random(shape) < 0.6, 1, rng.random(shape)).astype(np.float32)
    depth = rng.normal(0, 0.03, shape).astype(np.float32)
    near = rng.random(shape).astype(np.float32) if far else None
    limits = 0.2, 0.9, 0.02
    expected = hold_by_scipy(depth, share, near, *limits)
    assert far or shape[0] == 1 or shape[1] == 1 or (expected == 0).any()
    arguments = depth, share, near, np.empty(20 * depth.size, np.float32), np.empty(shape, np.float32)
    assert_kernel_agrees(room._rest_hold, lambda *_: expected, *arguments, *limits)


@pytest.mark.parametrize(
    ("coarse", "shape"), [((3, 5), (12, 20)), ((3, 4), (13, 19)), ((1, 2), (3, 9)), ((1, 1), (5, 2))]
)
def test_a_coarse_map_is_spread_bilinearly(coarse, shape):
    rng = np.random.default_rng(2)
    values, chosen = rng.random(coarse).astype(np.float32), rng.random(shape) < 0.7
    places = [np.clip((np.arange(n) + 0.5) * m / n - 0.5, 0, m - 1) for n, m in zip(shape, coarse)]
    spread = ndimage.map_coordinates(values.astype(float), np.meshgrid(*places, indexing="ij"), order=1)
    work, out = np.empty(4 * shape[1], np.float32), np.empty(shape, np.float32)
    assert_kernel_agrees(room._spread_over_chosen, lambda *_: chosen * spread, values, chosen, work, out)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 2), (13, 30), (60, 80)])
def test_distances_are_those_of_opencv(shape):
    for share in (0.0, 0.03, 0.3):
        chosen = np.random.default_rng(8).random(shape) < share
        chosen.flat[chosen.size // 3] = True
        work = np.empty((shape[0] + 2) * (shape[1] + 2), np.float32)

        def by_opencv(chosen, work, distance):
            return cv2.distanceTransform((~chosen).view(np.uint8), cv2.DIST_L2, 3).reshape(chosen.shape)

        found = np.zeros(shape, np.float32)
        assert_kernel_agrees(room._distance_to_chosen, by_opencv, chosen, work, found)
