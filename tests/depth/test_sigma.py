"""The standard deviation of depth: its kernel, its parts one by one, and what it says of simulated frames."""

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
import scipy.fft
from scipy import ndimage
from scipy.special import k1

from gelform.depth import coarse as coarse_module
from gelform.depth import sigma
from gelform.depth.coarse import Coarse, coarse_of
from gelform.depth.sigma import (
    LENGTH,
    PULL,
    WINDOW,
    DepthSigma,
    contradicted_slopes,
    squared_factor,
    steep_finding,
)
from gelform.depth.solvers.dct import CosineFilter
from gelform.errors import ConvergenceError
from gelform.slopes.gradients import slopes_of_solution
from kernel_agreement import assert_kernel_agrees

SHAPE, PITCH, FULL = (120, 160), 0.1, 0.05
ALL = np.ones(SHAPE, bool)


def errors_of(depth, at_rest=ALL, read=0.02, steep=0.0, factor=1.0, gain=0.0, known=ALL):
    depth = np.asarray(depth, np.float32)
    read, steep = (np.broadcast_to(np.float32(one), depth.shape).copy() for one in (read, steep))
    made = DepthSigma(depth.shape, PITCH, full_confidence_sigma=FULL, factor=factor, gain_sigma=gain)
    return made(slopes_of_solution(depth, (PITCH, PITCH)), depth, at_rest, known, read, steep)


def bump(height, center=(60, 80), width=12.0):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return height * np.exp(-((y - center[0]) ** 2 + (x - center[1]) ** 2) / (2 * width**2))


def test_one_error_moves_depth_by_the_squared_influence_of_a_membrane():
    """Far from its cell, where a mean over cells is a point; the borders mirror it."""
    coarse = coarse_of(SHAPE)
    cells = np.zeros((1, *coarse.shape), np.float32)
    cells[0, 15, 20] = 1
    found = CosineFilter(sigma._spread(coarse, SHAPE)[None])(cells)[0]
    length = SHAPE[0] * LENGTH
    for row, column in ((15, 26), (21, 20), (10, 15)):
        y, x = 4 * (row - 15), 4 * (column - 20)
        mirrored = [(y, x), (-(4 * (row + 15 + 1)), x), (4 * (59 - row - 15), x)]
        wanted = 16 * sum((k1(np.hypot(*one) / length) / (2 * np.pi * length)) ** 2 for one in mirrored)
        assert found[row, column] == pytest.approx(wanted, rel=0.06)


@pytest.mark.parametrize("shape", [(30, 40), (7, 13), (2, 2), (5, 131)])
def test_the_filter_multiplies_cosine_modes(shape):
    rng = np.random.default_rng(0)
    maps, gains = (rng.normal(size=(3, *shape)).astype(np.float32) for _ in range(2))
    modes = scipy.fft.dctn(maps.astype(float), axes=(1, 2), norm="ortho")
    wanted = scipy.fft.idctn(modes * gains, axes=(1, 2), norm="ortho")
    np.testing.assert_allclose(CosineFilter(gains)(maps), wanted, atol=1e-4)


def test_the_window_is_a_mean():
    coarse = coarse_of(SHAPE)
    gains = sigma._window(coarse, SHAPE)
    level = CosineFilter(gains[None])(np.full((1, *coarse.shape), 3.0, np.float32))
    np.testing.assert_allclose(level, 3.0, rtol=1e-4)
    spot = np.zeros((1, *coarse.shape), np.float32)
    spot[0, 15, 20] = 1
    found = CosineFilter(gains[None])(spot)[0]
    steps = SHAPE[0] * WINDOW / 4
    assert found[15, 20 + 5] / found[15, 20] == pytest.approx(np.exp(-((5 / steps) ** 2) / 2), rel=0.03)


def test_it_grows_with_the_factor_and_with_the_slopes_at_rest():
    rough = 2e-4 * np.random.default_rng(0).normal(size=SHAPE)
    rough -= rough.min()  # no negative depth
    one, twice = (errors_of(rough, read=1.0, factor=f).sigma(9.0) for f in (1.0, 2.0))
    np.testing.assert_allclose(twice, 2 * one, rtol=1e-3)
    np.testing.assert_allclose(errors_of(2 * rough, read=1.0).sigma(9.0), 2 * one, rtol=1e-3)


def test_at_rest_a_slope_counts_up_to_what_it_may_be_off_and_elsewhere_in_part():
    ramp = np.tile(PITCH * 0.2 * np.arange(SHAPE[1]), (SHAPE[0], 1))
    rest, moved = errors_of(ramp), errors_of(ramp, ~ALL)
    alike = rest.spread / sigma._beside_border(coarse_of(SHAPE), SHAPE)
    np.testing.assert_allclose(alike, alike[0, 0], rtol=1e-3)
    assert rest.spread[15, 0] == pytest.approx(2 * rest.spread[15, 20], rel=0.15), "a border doubles it"
    np.testing.assert_allclose(moved.spread / rest.spread, 2 * FULL**2 * 0.72 / (2 * 0.02**2), rtol=1e-3)


@pytest.mark.parametrize("own", [0.0, 0.2, 0.4, 1.5])
def test_the_squared_factor_makes_a_squared_error_the_variance(own):
    """For a frame without errors of its own, with less, with more, and with so many that slopes add nothing."""
    found, square = errors_of(bump(0.5)), np.float32(0.3)
    unit = np.maximum(found.spread, 1e-6)
    own = np.full_like(unit, own)
    factor = squared_factor(np.full_like(unit, square), own, unit)
    filtered = np.stack([factor * unit, unit, own, np.ones_like(unit)])
    local = replace(found, filtered=filtered, border=np.ones_like(unit)).coarse_variance
    if PULL * own[0, 0] > square:
        assert (factor == 0).all()
    else:
        np.testing.assert_allclose(local, square, rtol=1e-4)


def test_negative_depth_is_an_error_of_the_frame():
    valley = errors_of(bump(-0.1), factor=1e-3)
    flat = errors_of(0 * bump(1), factor=1e-3)
    low = valley.sigma(9.0)
    assert flat.sigma(9.0).max() < 1e-6
    assert 0.02 < low[60, 80] < 0.1
    assert low[5, 5] < 1e-3
    assert errors_of(bump(-0.1), factor=1e-3, known=~ALL).sigma(9.0).max() < 1e-3, "filled in"
    np.testing.assert_allclose(valley.coarse_variance[15, 20], PULL * valley.own[15, 20], rtol=0.05)


def test_a_valley_makes_the_deepest_contact_no_less_certain():
    """Noise of 10 um, and a border that sinks by 1 mm: twice the mean of its squares is no error of a hill far from it."""
    noise = np.kron(np.random.default_rng(0).normal(0, 0.01, (30, 40)), np.ones((4, 4)))
    found = errors_of(noise + bump(1.0) + bump(-1.0, (20, 4)), factor=1e-3)
    alone = found.coarse.at_pixel(found.of_contacts[2], (60, 80))
    for own in (alone**0.5, found.sigma(9.0, "outline")[60, 80]):
        assert own == pytest.approx((PULL * 0.01**2) ** 0.5, rel=0.3)
    assert found.sigma(9.0, "contact")[60, 80] > 0.05


def test_an_error_in_proportion_is_that_share_of_the_depth():
    depth, at_rest = bump(0.5), bump(1.0) < 0.01
    found = errors_of(depth, at_rest, gain=0.08, factor=1e-3)
    common = found.coarse.at_pixels(found.common_mm)
    assert common[60, 80] == pytest.approx(0.08 * 0.5, rel=0.06)
    np.testing.assert_allclose(np.median(common[at_rest]), 0, atol=1e-4)
    assert not found.steep_mm.any()


def test_slopes_that_are_no_surface_s_are_said():
    """Noise as large as half of the slopes, or a hole for a hill; not at rest, where all slopes are noise."""
    rng = np.random.default_rng(0)
    depth, contact = np.float32(bump(1.0)), bump(1.0) > 0.1
    solved = slopes_of_solution(depth, (PITCH, PITCH))
    size = np.sqrt(np.mean(solved[contact] ** 2))

    def found(noise, depth=depth, contact=contact):
        read = solved + np.float32(noise * size) * rng.normal(size=solved.shape).astype(np.float32)
        return contradicted_slopes(read, solved, depth, contact)

    assert found(0.4) == found(0.4, contact=np.zeros_like(contact)) == ()
    (noisy,) = found(0.7)
    assert noisy.name == "slopes_contradict"
    assert noisy.figure == pytest.approx(0.7, rel=0.05)
    (hole,) = found(0.1, depth=-depth + np.float32(0.3))
    assert "the deepest valley has 2" in hole.message


def test_steep_slopes_may_miss_depth_and_are_named_where_that_is_most():
    depth, at_rest = bump(2.0), bump(1.0) < 0.01
    size = np.linalg.norm(slopes_of_solution(np.float32(depth), (PITCH, PITCH)), axis=-1)
    found = errors_of(depth, at_rest, steep=(0.5 * size) * (size > 0.05), factor=1e-3)
    gentle = errors_of(depth, at_rest, steep=0.15, factor=1e-3)  # not doubted
    assert not gentle.steep_mm.any()
    np.testing.assert_allclose(found.common_mm, found.steep_mm, atol=1e-6)
    assert found.steep_mm.max() > 0.05
    rows = np.float32(depth), depth > 0.2, np.full(SHAPE, 0.3, np.float32)
    (finding,) = steep_finding(*rows, found)
    assert finding.name == "steep"
    assert finding.figure == pytest.approx(found.coarse.at_pixels(found.steep_mm)[60, 80], rel=1e-5)
    assert finding.message.startswith("100 % of the contact are faces")
    assert steep_finding(*rows, gentle) == ()
    assert steep_finding(*rows, replace(found, gain_sigma=1.0)) == (), "the rest is as uncertain"


def test_gel_at_rest_beside_steep_faces_is_at_0_and_a_plateau_is_as_wrong_as_its_walls():
    """A flat face has the color of rest. One wall of two is doubted, as where presses have shown one side alone."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    across = np.hypot(x - 80, y - 60)
    depth = np.clip((34 - across) / 10, 0, 1).astype(np.float32)
    wall = (across > 22) & (across < 36)
    found = errors_of(depth, ~wall, steep=0.6 * (wall & (x > 80)), factor=1e-3)
    common = found.coarse.at_pixels(found.common_mm)
    assert np.abs(common[across > 44]).max() < 1e-6
    assert np.abs(common[across < 18]).mean() > 0.1


def test_it_is_bounded_and_the_contact_s_is_without_what_is_common():
    depth, at_rest = bump(0.5), bump(1.0) < 0.01
    found = errors_of(depth, at_rest, gain=0.5)
    assert found.sigma(0.01).max() == pytest.approx(0.01)
    assert found.sigma(9.0, "contact")[60, 80] < 0.5 * found.sigma(9.0)[60, 80]
    with pytest.raises(ConvergenceError, match="Expected a finite standard deviation of depth"):
        errors_of(1e25 * bump(-1.0))


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (17, 29), (120, 160)])
def test_a_grid_of_any_size(shape):
    found = Coarse(shape)
    assert min(found.shape) >= 2
    level = found.at_pixels(found.means(np.full((*shape, 1), 2.0, np.float32))[0][..., 0])
    np.testing.assert_allclose(level, 2, rtol=1e-6)
    if min(shape) > 1:
        made = DepthSigma(shape, PITCH, full_confidence_sigma=FULL, factor=1.0, gain_sigma=0.1)
        depth = np.ones(shape, np.float32)
        maps = depth > 0, depth > 0, 0.01 * depth, 0 * depth
        assert np.isfinite(made(slopes_of_solution(depth, (PITCH, PITCH)), depth, *maps).sigma(1.0)).all()


def numpy_errors(
    slopes, depth, at_rest, known, read, steep, rows, columns, work, cells, own, full, spill, rest_share, of_contact, gain,
    doubted, least, per_median,
):  # fmt: skip
    """What the kernel should give, in float64."""
    g = slopes.astype(float)
    square = (g**2).sum(-1)
    noise = np.minimum(square, 2 * np.minimum(read, full) ** 2)
    low, doubt = np.minimum(depth, 0), np.where(steep > doubted, steep.astype(float) ** 2, 0)
    unit = g / np.sqrt(np.maximum(square, 1e-12))[..., None]
    added = (np.sqrt(gain**2 * square + doubt) - gain * np.sqrt(square))[..., None] * unit
    alone = np.sqrt(doubt)[..., None] * unit
    maps = [
        np.where(at_rest, noise, np.minimum(spill**2 * square, 2 * full**2)),
        np.where(at_rest, rest_share * noise, np.minimum(of_contact**2 * square, 2 * np.minimum(2 * read, full) ** 2)),
        2 * low**2 * known, (at_rest | (low < 0)) & known, depth, *np.moveaxis(added, -1, 0),
        *np.moveaxis(alone, -1, 0), at_rest,
    ]  # fmt: skip
    cells = [[[one[a:b, c:d] for c, d in pairwise(columns)] for a, b in pairwise(rows)] for one in maps]
    cells = np.array([[[cell.sum() / max(cell.size, 1) for cell in row] for row in one] for one in cells])
    below, own = cells[2], cells[2].mean() / max(cells[3].mean(), least)
    usual = np.median(below[below > 0]) if below.any() else 0.0
    return cells, np.array([own, min(per_median * usual, own)])


def test_the_kernel_agrees_with_numpy():
    assert_kernel_agrees(sigma._depth_errors, numpy_errors)


def test_a_map_over_its_largest_part_at_rest_agrees_with_scipy():
    """Of parts of one size the first; parts that touch at corners are two."""

    def by_scipy(values, at_rest, work, share):
        labels, count = ndimage.label(at_rest > np.float32(share))
        if not count:
            return values
        largest = labels == 1 + np.argmax(np.bincount(labels.ravel())[1:])
        return np.where(largest, 0, values - np.median(values[largest]))

    assert_kernel_agrees(sigma._over_rest, by_scipy)

    def variances(
        common, at_rest, filtered, border, work, share, _, of_frame, usual, pull, least_free, least
    ):
        common = by_scipy(common, at_rest, work, share)
        spread, of_contact = np.maximum(filtered[:2].astype(float) * border, least)
        own = filtered[2] / np.maximum(filtered[3], least_free)
        of_slopes = np.stack([spread, spread, of_contact, 0 * spread, of_contact])
        negative = np.stack(
            [own, own, np.maximum(own, of_frame), np.maximum(own, usual), np.full_like(own, usual)]
        )
        found = of_slopes + pull * np.maximum(negative - of_slopes, 0)
        found[1] += common.astype(float) ** 2
        return common, np.stack([spread, own, *found])

    assert_kernel_agrees(sigma._depth_variances, variances)


def test_a_variance_on_the_grid_is_a_deviation_at_every_pixel():
    """As OpenCV maps it, at any size, and at one pixel alone."""

    def by_opencv(variance, lost, work, out, most):
        found = np.sqrt(cv2.resize(variance.astype(float), out.shape[::-1], interpolation=cv2.INTER_LINEAR))
        return np.where(False if lost is None else lost, most, np.minimum(found, most))

    assert_kernel_agrees(coarse_module._root_at_pixels, by_opencv)
    coarse, values = coarse_of((13, 30)), np.random.default_rng(0).random((3, 7), dtype=np.float32)
    found = [[coarse.at_pixel(values, (y, x)) for x in range(30)] for y in range(13)]
    np.testing.assert_allclose(found, coarse.at_pixels(values), atol=1e-5)
