"""Regions of an outline: what speaks for each, and which of them stand."""

import cv2
import numpy as np
import pytest
from scipy import ndimage
from scipy.special import k1

from gelform._native import Kernel
from gelform.depth.contact import PreparedContact
from kernel_agreement import assert_kernel_agrees

# The last steps of `contact_mask`, each by itself.
REGION_EVIDENCE = Kernel(
    "region_evidence",
    "u16[h,w] labels, f32[h,w] depth, f32[h,w] sigma, f32[h,w] evidence, f32[h,w] smooth, f32[h,w] bent, f32[t] influence, "
    "out f64[n,7] measures, f32 stiffness, f32 per_x, f32 per_y",
)
VARIANCE_BELOW = Kernel("variance_below", "f32[...] depth, f32[...] sigma, out f64[1] excess, i64 step")
REGIONS_THAT_STAND = Kernel(
    "regions_that_stand",
    "f64[n,7] measures, f32[r,c]? alone, out bool[m] stands, out i32[m,2] deepest, f64 excess, f64 least, f32 factor, "
    "f32 most, i64 height, i64 width",
)

PITCH, LENGTH, FACTOR = 0.05, 0.6, 3.5
INFLUENCE = PreparedContact((PITCH, PITCH), LENGTH, np.ones((12, 14), np.float32))._influence


def measured(number, labels, depth, *maps):
    """What speaks for each region."""
    measures = np.empty((number, 7))
    REGION_EVIDENCE(labels, depth, *maps, INFLUENCE, measures, LENGTH**-2, 1.0, 1.0)
    return measures


def judged(number, labels, depth, sigma, *maps, alone=None, area=0.05):
    """Which labels stand, and the (y, x) of their deepest pixels."""
    excess, stands, deepest = np.empty(1), np.empty(number + 1, bool), np.empty((number + 1, 2), np.int32)
    VARIANCE_BELOW(depth, sigma, excess, step=3)
    numbers = excess.item(), area / PITCH**2, FACTOR, 9.0
    measures = measured(number, labels, depth, sigma, *maps)
    REGIONS_THAT_STAND(measures, alone, stands, deepest, *numbers, *depth.shape)
    return stands, deepest


def distance(x, y, shape=(120, 140)):
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    return np.hypot(columns - x, rows - y) * PITCH


def depth_of(pressure):
    """Depth that a pressure makes on a membrane over an elastic bed, by a sum over its pixels."""
    depth = np.zeros(pressure.shape)
    rows, columns = np.nonzero(pressure)
    for y, x in zip(rows, columns):
        square = (np.arange(pressure.shape[0])[:, None] - y) ** 2 + (np.arange(pressure.shape[1]) - x) ** 2
        depth += pressure[y, x] * np.append(INFLUENCE, 0)[np.minimum(square, len(INFLUENCE))]
    return depth


def regions_of(mask, depth, sigma, whole, noise=0.02):
    """An outline, its depth, and the evidence of a pressure of that noise; the surface is given by its whole pressure."""
    labels, number = ndimage.label(mask, np.ones((3, 3)))
    sigma = sigma * np.ones(depth.shape)
    evidence = np.where(mask, whole, 0) ** 2 / (noise**2 + (sigma / LENGTH**2) ** 2)
    maps = depth, sigma, evidence, depth, whole - depth / LENGTH**2
    return number, labels.astype(np.uint16), *(np.ascontiguousarray(values, np.float32) for values in maps)


def standing(regions, **how):
    return judged(*regions, **how)[0].tolist()


def test_the_depth_of_a_pressed_disc_is_that_of_the_analytic_one():
    """A uniform pressure p on a disc makes p L^2 (1 - R/L K1(R/L)) at its center."""
    radius = 1.0
    mask = distance(70, 60) < radius
    measures = measured(*regions_of(mask, depth_of(0.8 * mask), 0.01, 0.8 * mask))
    wanted = 0.8 * LENGTH**2 * (1 - radius / LENGTH * k1(radius / LENGTH))
    assert measures[0, 6] == pytest.approx(wanted, rel=0.01)
    assert tuple(measures[0, 2:4]) == (70, 60)


def test_a_contact_stands_and_gel_that_it_draws_down_does_not():
    """Beside a disc lies a speck whose depth is the disc's: sure, but without pressure of its own."""
    disc, speck = distance(50, 60) < 1.0, distance(84, 60) < 0.25
    whole = 0.8 * disc + 0.12 * speck
    depth = depth_of(whole)
    stands, deepest = judged(*regions_of(disc | speck, depth, 0.01, whole, 0.02))
    assert stands.tolist() == [False, True, False]
    assert deepest[1].tolist() == [60, 50]
    alone = depth_of(0.12 * speck)
    assert standing(regions_of(speck, alone, 0.0005, 0.12 * speck, 0.015)) == [False, True]


def test_the_deepest_region_stands_by_a_deviation_of_its_own():
    """A valley may be its reaction, which makes other regions doubtful, but not itself."""
    deep, less = distance(50, 60) < 1.0, distance(104, 60) < 0.6
    whole = 0.8 * deep + 0.5 * less
    number, labels, depth, sigma, *maps = regions_of(deep | less, depth_of(whole), 0.08, whole)
    assert judged(number, labels, depth, sigma, *maps)[0].tolist() == [False, False, False]
    own = judged(number, labels, depth, sigma, *maps, alone=np.square(sigma[::4, ::4] / 10))[0]
    assert own[labels[60, 50]]
    assert not own[labels[60, 104]]


@pytest.mark.parametrize(
    ("sigma", "area", "stands"), [(0.01, 0.05, True), (0.5, 0.05, False), (0.01, 9.0, False)]
)
def test_depth_and_area_have_to_be_enough(sigma, area, stands):
    disc = distance(50, 60) < 1.0
    regions = regions_of(disc, depth_of(0.8 * disc), sigma, 0.8 * disc)
    assert standing(regions, area=area) == [False, stands]


def test_a_depth_of_zero_or_less_is_no_contact():
    none = np.zeros((12, 14), bool)
    assert standing(regions_of(none, np.zeros(none.shape), 0.01, np.zeros(none.shape))) == [False]
    disc = distance(50, 60) < 1.0
    for depth in (0 * depth_of(disc), -depth_of(disc)):
        assert standing(regions_of(disc, depth, 0.01, 0.8 * disc)) == [False, False]


def test_tops_of_a_texture_stand_each_by_its_own_depth():
    """Each top makes a fifth of its depth: enough where that part is sure, though the neighbors make the rest."""
    tops = [distance(x, y) < 0.2 for x in (50, 60, 70) for y in (50, 60, 70)]
    every = np.any(tops, axis=0)
    depth = depth_of(0.18 * every)
    for sigma, stand in ((0.0005, True), (0.02, False)):
        assert standing(regions_of(every, depth, sigma, 0.18 * every)) == [False] + 9 * [stand]


def test_a_frame_noisier_than_it_says_shows_contacts_of_more_depth():
    """A quarter of the gel lies below 0 by more than sigma explains; even an overwhelming pressure is not sure then."""
    speck = distance(50, 60) < 0.25
    depth = depth_of(0.12 * speck)
    for lowered, noise, stands in ((0.0005, 0.02, True), (0.004, 0.02, False), (0.004, 0.004, False)):
        uneven = depth.copy()
        uneven[:30] -= lowered
        assert standing(regions_of(speck, uneven, 0.0005, 0.12 * speck, noise)) == [False, stands]


def test_evidence_agrees_with_numpy():
    def by_numpy(labels, depth, sigma, evidence, smooth, bent, influence, measures, stiffness, per_x, per_y):
        y, x = np.indices(labels.shape)
        rows = np.zeros(measures.shape)
        for k in set(labels.ravel().tolist()) - {0}:
            here = labels == k
            top = np.argmax(np.where(here, depth, -9))
            at = (per_x * (x - x.flat[top]) ** 2 + per_y * (y - y.flat[top]) ** 2).astype(int)
            per = np.append(influence, 0)[np.minimum(at, len(influence))]
            own = np.where(here, per * (bent + stiffness * smooth), 0)
            deepest = depth.flat[top], x.flat[top], y.flat[top], sigma.flat[top]
            rows[k - 1] = [here.sum(), *deepest, evidence[here].max(), own.sum()]
        return rows

    assert_kernel_agrees(REGION_EVIDENCE, by_numpy)


def test_what_negative_depths_have_more_agrees_with_numpy():
    def by_numpy(depth, sigma, excess, step):
        z, s = (one.ravel()[::step].astype(float) for one in (depth, sigma))
        more, weight = (z**2 - s**2)[z < 0], s[z < 0] ** -2
        return np.array([max(np.average(more, weights=weight), 0) if more.size else 0])

    assert_kernel_agrees(VARIANCE_BELOW, by_numpy)


def test_regions_that_stand_agree_with_numpy():
    """The deepest one by the variance at its place on a coarser grid, as OpenCV maps it."""
    rng = np.random.default_rng(0)
    for n, alone in ((0, None), (1, rng.random((2, 3))), (9, None), (9, rng.random((4, 5)))):
        y, x = rng.integers(0, (8, 15), (n, 2)).T
        measures = np.column_stack([rng.uniform(1, 9, (n, 2)), x, y, rng.uniform(0, 2, (n, 3))])

        def by_numpy(of, alone, stands, deepest, excess, least, factor, most, height, width):
            found = np.minimum(of[:, 1], of[:, 6])
            variance = of[:, 4] ** 2
            if alone is not None:
                at = cv2.resize(alone, (width, height), interpolation=cv2.INTER_LINEAR)
                k = np.argmax(found)
                variance[k] = min(at[y[k], x[k]], most**2)  # noqa: B023
            sure = np.minimum(found / np.sqrt(2 * variance + excess), np.sqrt(of[:, 5]))
            return (
                np.append(False, (of[:, 0] >= least) & (sure > factor)),
                np.vstack([[0, 0], np.stack([y, x], -1)]),  # noqa: B023
            )

        alone = None if alone is None else alone.astype(np.float32)
        outputs = np.empty(n + 1, bool), np.empty((n + 1, 2), np.int32)
        for numbers in ((0.1, 3.0, 0.5, 0.6), (0.0, 0.0, 0.9, 9.0)):
            assert_kernel_agrees(REGIONS_THAT_STAND, by_numpy, measures, alone, *outputs, *numbers, 8, 15)
