"""Regions of an outline: what speaks for each, and which of them stand."""

import numpy as np
import pytest
from scipy.special import k1

from gelform.depth import contact as evidence_module
from gelform.depth.contact import Evidence, labeled
from kernel_agreement import assert_kernel_agrees

PITCH, LENGTH, FACTOR = 0.05, 0.6, 3.5


def judge(**how):
    usual = {"pitch": (PITCH, PITCH), "length_mm": LENGTH, "noise_factor": FACTOR, "min_area_mm2": 0.05}
    return Evidence(**usual | how)


def distance(x, y, shape=(120, 140)):
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    return np.hypot(columns - x, rows - y) * PITCH


def depth_of(pressure):
    """Depth that a pressure makes on a membrane over an elastic bed, by a sum over its pixels."""
    depth, influence = np.zeros(pressure.shape), judge()._influence
    rows, columns = np.nonzero(pressure)
    for y, x in zip(rows, columns):
        square = (np.arange(pressure.shape[0])[:, None] - y) ** 2 + (np.arange(pressure.shape[1]) - x) ** 2
        depth += pressure[y, x] * np.append(influence, 0)[np.minimum(square, len(influence))]
    return depth


def regions_of(mask, depth, sigma, whole, noise=0.02):
    """An outline, its depth, and the evidence of a pressure of that noise; the surface is given by its whole pressure."""
    number, labels = labeled(mask)
    sigma = sigma * np.ones(depth.shape)
    evidence = np.where(mask, whole, 0) ** 2 / (noise**2 + (sigma / LENGTH**2) ** 2)
    maps = depth, sigma, evidence, depth, whole - depth / LENGTH**2
    return number, labels, *(np.ascontiguousarray(values, np.float32) for values in maps)


def standing(regions, **how):
    return judge(**how)(*regions)[0].tolist()


def test_the_depth_of_a_pressed_disc_is_that_of_the_analytic_one():
    """A uniform pressure p on a disc makes p L^2 (1 - R/L K1(R/L)) at its center."""
    radius, measures = 1.0, np.empty((1, 7))
    mask = distance(70, 60) < radius
    regions = regions_of(mask, depth_of(0.8 * mask), 0.01, 0.8 * mask)
    evidence_module._region_evidence(*regions[1:], judge()._influence, measures, LENGTH**-2, 1.0, 1.0)
    wanted = 0.8 * LENGTH**2 * (1 - radius / LENGTH * k1(radius / LENGTH))
    assert measures[0, 6] == pytest.approx(wanted, rel=0.01)
    assert tuple(measures[0, 2:4]) == (70, 60)


def test_a_contact_stands_and_gel_that_it_draws_down_does_not():
    """Beside a disc lies a speck whose depth is the disc's: sure, but without pressure of its own."""
    disc, speck = distance(50, 60) < 1.0, distance(84, 60) < 0.25
    whole = 0.8 * disc + 0.12 * speck
    depth = depth_of(whole)
    stands, deepest = judge()(*regions_of(disc | speck, depth, 0.01, whole, 0.02))
    assert stands.tolist() == [False, True, False]
    assert deepest[1].tolist() == [60, 50]
    alone = depth_of(0.12 * speck)
    assert standing(regions_of(speck, alone, 0.0005, 0.12 * speck, 0.015)) == [False, True]


def test_the_deepest_region_stands_by_a_deviation_of_its_own():
    """A valley may be its reaction, which makes other regions doubtful, but not itself."""
    deep, less = distance(50, 60) < 1.0, distance(104, 60) < 0.6
    whole = 0.8 * deep + 0.5 * less
    number, labels, depth, sigma, *maps = regions_of(deep | less, depth_of(whole), 0.08, whole)
    assert judge()(number, labels, depth, sigma, *maps)[0].tolist() == [False, False, False]
    own = judge()(number, labels, depth, sigma, *maps, lambda place: sigma[place] / 10)[0]
    assert own[labels[60, 50]]
    assert not own[labels[60, 104]]


@pytest.mark.parametrize(
    ("sigma", "area", "stands"), [(0.01, 0.05, True), (0.5, 0.05, False), (0.01, 9.0, False)]
)
def test_depth_and_area_have_to_be_enough(sigma, area, stands):
    disc = distance(50, 60) < 1.0
    regions = regions_of(disc, depth_of(0.8 * disc), sigma, 0.8 * disc)
    assert standing(regions, min_area_mm2=area) == [False, stands]


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

    assert_kernel_agrees(evidence_module._region_evidence, by_numpy)


def test_what_negative_depths_have_more_agrees_with_numpy():
    def by_numpy(depth, sigma, excess, step):
        z, s = (one.ravel()[::step].astype(float) for one in (depth, sigma))
        more, weight = (z**2 - s**2)[z < 0], s[z < 0] ** -2
        return np.array([max(np.average(more, weights=weight), 0) if more.size else 0])

    assert_kernel_agrees(evidence_module._variance_below, by_numpy)
