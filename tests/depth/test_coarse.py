"""What is held at rest: untouched gel, drifted gel too, but never the flat face of something pressed. Coarse depth of
whole frames, by which the steps of the response go.
"""

import cv2
import numpy as np
import pytest
from scipy import ndimage

from gelform.depth import coarse as room
from gelform.depth.coarse import (
    COARSER,
    REACH_MM,
    REST_SIGMA_MM,
    CoarseDepth,
    RestAnchor,
    coarse_of,
)
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
    [(0.15, 22, 0.02, 0.03), (0.5, 22, 0.02, 0.03), *((mm, 10, 0.04, 0.01) for mm in (0.05, -0.05, 0.1))],
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


def test_untouched_gel_is_held_as_the_units_say_within_a_ring_too():
    """Inside an O-ring the gel is where it was: enclosed, and no face."""
    np.testing.assert_allclose(anchored(np.zeros((*SHAPE, 2), np.float32), EVERYWHERE), HOLD, rtol=1e-3)
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


def overlaps(pixels, cells):
    """Length (cells, pixels) that each cell has of each pixel."""
    edges = np.linspace(0, pixels, cells + 1)
    at = np.arange(pixels)
    return np.maximum(np.minimum(edges[1:, None], at + 1) - np.maximum(edges[:-1, None], at), 0)


def means_by_numpy(values, seen, cells):
    down, across = (overlaps(n, m) for n, m in zip(values.shape, cells))
    weight = np.ones(values.shape[:2]) if seen is None else seen.astype(float)
    area = down @ weight @ across.T
    sums = np.einsum("ry,yxc,kx->rkc", down, values.astype(float) * weight[..., None], across)
    return sums / np.where(area > 0, area, 1)[..., None], area / np.outer(down.sum(1), across.sum(1))


@pytest.mark.parametrize("masked", [False, True])
def test_means_over_cells_agree_with_numpy(masked):
    """Cells of whole pixels and of parts of them; hidden pixels are left out, and a cell without a seen one is 0."""

    def by_numpy(values, seen, work, cells, shares):
        return means_by_numpy(values, seen, cells.shape[:2])

    rng = np.random.default_rng(0)
    for shape, cells in (((8, 12), (2, 3)), ((17, 29), (4, 7)), ((3, 5), (2, 2)), ((1, 2), (2, 2))):
        for channels in (0, 1, 3):
            values = rng.normal(size=(*shape, channels)).astype(np.float32)
            seen = rng.uniform(size=shape) < 0.3 if masked else None
            arguments = values, seen, np.empty((channels + 1) * shape[1] + 4 * cells[1], np.float32)
            found = np.empty((*cells, channels), np.float32), np.empty(cells, np.float32)
            assert_kernel_agrees(room._cell_means, by_numpy, *arguments, *found)


def over_rest_by_numpy(change, slopes, rest, work, most, share):
    """At least a share of the cells, those with the least change, is at rest."""
    change = change - np.median(change, axis=(0, 1))
    square = (change.astype(float) ** 2).sum(-1)
    rest = square <= most
    if rest.sum() < share * rest.size:
        rest = square <= np.quantile(square, share, method="lower")
    return change, slopes - np.median(slopes[rest], axis=0), rest


def test_cells_at_rest_agree_with_numpy():
    """Of a frame at once too, unless a cell has no seen pixel."""

    def of_frame(change, slopes, seen, work, change_cells, slope_cells, shares, rest, most, share):
        change, shares = means_by_numpy(change, seen, shares.shape)
        slopes, _ = means_by_numpy(slopes, seen, shares.shape)
        if shares.all():
            change, slopes, rest = over_rest_by_numpy(change, slopes, rest, work, most, share)
        return change, slopes, shares, rest

    assert_kernel_agrees(room._slopes_over_rest, over_rest_by_numpy)
    assert_kernel_agrees(room._cells_over_rest, of_frame)
    rng = np.random.default_rng(1)
    change, slopes = (rng.normal(size=(16, 12, channels)).astype(np.float32) for channels in (3, 2))
    cells = [np.zeros((4, 3, channels), np.float32) for channels in (3, 2, 1)]
    rest, work = np.zeros((4, 3), bool), np.empty(60, np.float32)
    for hidden in (3, 4):  # px; the first cell has four
        seen = np.ones((16, 12), bool)
        seen[:hidden, :4] = False
        found = *cells[:2], cells[2][..., 0].copy(), rest
        assert_kernel_agrees(room._cells_over_rest, of_frame, change, slopes, seen, work, *found, 3.0, 0.1)


def hold_by_scipy(depth, share, far, hold, least, face):
    """Of regions that share an edge; those that touched gel encloses are free where they are off rest in the mean."""
    rest = share >= min(least, share.max())
    z = depth.astype(np.float64) - np.median(depth[rest])
    weight = hold * far.astype(np.float64)
    labels, count = ndimage.label(rest)
    border = np.ones(depth.shape, bool)
    border[1:-1, 1:-1] = False
    for label in range(1, count + 1):
        region = labels == label
        if not (region & border).any() and abs(z[region].mean()) > face:
            weight[region] = 0
    return weight


def test_the_hold_of_a_coarse_depth_is_spread_bilinearly():
    found = []

    def by_scipy(depth, share, far, at_rest, work, anchor, *limits):
        found.append(hold_by_scipy(depth, share, far, *limits))
        sizes = zip(at_rest.shape, depth.shape)
        places = [np.clip((np.arange(n) + 0.5) * m / n - 0.5, 0, m - 1) for n, m in sizes]
        at = np.meshgrid(*places, indexing="ij")
        return at_rest * ndimage.map_coordinates(found[-1], at, order=1)

    assert_kernel_agrees(room._rest_anchor, by_scipy)
    assert any((one == 0).any() for one in found)


def test_distances_from_touched_cells_are_those_of_opencv():
    def by_opencv(at_rest, work, share, distance, least):
        down, across = (overlaps(n, m) for n, m in zip(at_rest.shape, share.shape))
        share = down @ at_rest @ across.T / np.outer(down.sum(1), across.sum(1))
        touched = share.astype(np.float32) < min(least, share.astype(np.float32).max())
        distance = cv2.distanceTransform((~touched).view(np.uint8), cv2.DIST_L2, 3).reshape(share.shape)
        return share, distance if touched.any() else np.full(share.shape, np.inf)

    assert_kernel_agrees(room._distance_from_touched, by_opencv)


ODD = (90, 121)


def bump(shape=ODD, height_px=4.0, width_px=10.0, center=(70, 40)):
    """Depth (H, W), px, and slopes (H, W, 2) of a Gaussian bump, and a color change that is there where it is."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    dx, dy = x - center[0], y - center[1]
    depth = height_px * np.exp(-(dx**2 + dy**2) / (2 * width_px**2))
    slopes = np.stack([-dx, -dy], axis=-1) * (depth / width_px**2)[..., None]
    change = np.repeat(np.linalg.norm(slopes, axis=-1, keepdims=True), 3, axis=-1)
    return depth, slopes.astype(np.float32), change.astype(np.float32)


def coarse(values):
    """Means over the coarser grid."""
    return cv2.resize(values, coarse_of(values.shape[:2]).shape[::-1], interpolation=cv2.INTER_AREA)


@pytest.mark.parametrize("shape", [(90, 120), (90, 121), (89, 122)])
def test_the_grid_covers_the_frame(shape):
    (rows, columns), (x_px, y_px) = coarse_of(shape).shape, coarse_of(shape).pitch_px
    assert (rows * y_px, columns * x_px) == pytest.approx(shape)
    assert COARSER <= min(x_px, y_px) <= max(x_px, y_px) < 1.1 * COARSER
    assert (coarse_of((1, 5)).shape, coarse_of((1, 5)).pitch_px) == ((2, 2), (2.5, 0.5)), "the smallest"


@pytest.mark.parametrize("shape", [(90, 120), ODD])
@pytest.mark.parametrize("offset", [0.0, 0.02])
def test_depth_is_that_of_the_slopes_and_0_where_the_gel_is_untouched(shape, offset):
    depth, slopes, change = bump(shape)
    found = CoarseDepth(shape, 0.01)(change + np.float32(offset), slopes + np.float32(offset))
    assert found.shape == coarse_of(shape).shape
    assert found.min() == 0
    np.testing.assert_allclose(found, coarse(depth), atol=0.15)
    assert found.max() == pytest.approx(coarse(depth).max(), rel=0.04)


def test_nothing_is_below_the_untouched_gel_and_what_is_hidden_altogether_is_level():
    """A dent and a bulge: the forward response knows pressed gel, so the bulge is at 0."""
    down, up = bump(center=(30, 40)), bump(center=(90, 45))
    measure = CoarseDepth(ODD, 0.01)
    found = measure(down[2] + up[2], down[1] - up[1])
    np.testing.assert_allclose(found, np.maximum(coarse(down[0] - up[0]), 0), atol=0.25)
    assert found.min() == 0
    assert not measure(down[2], down[1], np.ones(ODD, dtype=bool)).any()


def test_where_all_of_the_gel_is_touched_the_least_changed_is_at_0():
    """Gel that is bent everywhere: no color is as little changed as untouched gel's, and 2 % of them are taken for it."""
    y, x = np.mgrid[: ODD[0], : ODD[1]].astype(float)
    depth = 3 * np.sin(x / 15) * np.cos(y / 20)
    slopes = np.stack([np.cos(x / 15) * np.cos(y / 20) / 5, -0.15 * np.sin(x / 15) * np.sin(y / 20)], axis=-1)
    change = np.dstack([slopes, np.abs(slopes[..., 0]) + depth / 20]).astype(np.float32)
    slopes = slopes.astype(np.float32)
    means = coarse(change)
    size = np.linalg.norm(means - np.median(means, axis=(0, 1)), axis=-1)
    found, known, more = (
        CoarseDepth(ODD, limit)(change, slopes) for limit in (1e-9, *np.quantile(size, [0.02, 0.9]))
    )
    np.testing.assert_allclose(found, known, atol=0.2)
    assert np.abs(found - more).max() > 0.5, "what is guarded against"


def hidden_by(name, shape=ODD):
    """Markers of 7 px, 15 px apart, all over the frame, or a bar over a flank of the bump."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.hypot(x % 15 - 7, y % 15 - 7) < 3.5 if name == "dots" else (x >= 76) & (x < 84)


@pytest.mark.parametrize("name", ["dots", "bar"])
def test_what_hidden_pixels_show_does_not_count(name):
    """Their slopes and colors are anything: the depth is that of what is seen around them."""
    depth, slopes, change = bump()
    hidden, rng = hidden_by(name), np.random.default_rng(0)
    count = np.count_nonzero(hidden)
    garbled, colored = slopes.copy(), change.copy()
    garbled[hidden], colored[hidden] = rng.normal(1, 2, (count, 2)), rng.uniform(-1, 3, (count, 3))
    measure = CoarseDepth(ODD, 0.01)
    found = measure(colored, garbled, hidden)
    np.testing.assert_allclose(found, coarse(depth), atol=0.4)
    whole = cv2.resize(found, ODD[::-1], interpolation=cv2.INTER_LINEAR)
    np.testing.assert_array_equal(measure.at_pixels(colored, garbled, hidden), whole)
    assert np.abs(measure(colored, garbled) - coarse(depth)).max() > 2, "what is guarded against"
    other = measure(colored[..., ::-1].copy(), np.where(hidden[..., None], -garbled, garbled), hidden)
    np.testing.assert_allclose(other, found, atol=1e-4)
