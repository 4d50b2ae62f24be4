"""Errors of shape: the sigma of a linear figure of depth is its scatter when slopes are drawn and integrated."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import gelform
from gelform.result.shape import ShapeErrors

SHAPE, PITCH = (48, 64), 0.1


def errors(correlation_px=3.0, correlated_share=0.7, common=None):
    grid = tuple(n // 4 for n in SHAPE)
    common = np.zeros((1, *grid), np.float32) if common is None else common
    return ShapeErrors(np.zeros_like(common), common, 0.0, correlation_px, correlated_share, 1.25)


def step():
    weights = np.zeros(SHAPE)
    weights[20:28, 10:18], weights[20:28, 40:48] = -1 / 64, 1 / 64
    return weights


def drawn_depths(of, sigma, count, rng):
    """Depth, mm, of slopes that are errors with these deviations."""
    length = of.correlation_px / np.sqrt(2)
    for _ in range(count):
        white = rng.normal(size=(*SHAPE, 2))
        together = gaussian_filter(rng.normal(size=(*SHAPE, 2)), (length, length, 0), mode="wrap")
        together *= 2 * length * np.sqrt(np.pi)  # a Gaussian's squares sum to 1 / (4 pi length^2)
        share = of.correlated_share
        slopes = sigma * (np.sqrt(share) * together + np.sqrt(1 - share) * white)
        yield gelform.depth_from_gradients(slopes.astype(np.float32), mm_per_px=PITCH, solver="dct")


@pytest.mark.parametrize(("correlation_px", "share"), [(3.0, 0.7), (1.5, 1.0), (3.0, 0.0)])
def test_the_sigma_of_a_step_is_its_scatter(correlation_px, share):
    of, rng = errors(correlation_px, share), np.random.default_rng(3)
    sigma = np.full((*SHAPE, 2), 0.05)
    sigma[:, 30:, 1] = 0.2
    found = [np.sum(step() * z) for z in drawn_depths(of, sigma, 200, rng)]
    stated = PITCH * of.slope_sigma(step(), sigma)
    assert np.std(found) / stated == pytest.approx(1, abs=0.15)


def test_waves_say_how_far_off_its_plane_a_flat_region_is_read():
    of, rng = errors(), np.random.default_rng(4)
    waves = of.waves(*SHAPE)
    waves[:2, :2] = 0
    y, x = np.indices(SHAPE)
    terms = np.stack([np.ones(x.size), x.ravel(), y.ravel()], axis=1)
    off = [
        z.ravel() - terms @ np.linalg.lstsq(terms, z.ravel(), rcond=None)[0]
        for z in drawn_depths(of, 0.1, 60, rng)
    ]
    assert np.sqrt(np.mean(np.square(off))) / (0.1 * PITCH * np.sqrt(waves.mean())) == pytest.approx(
        1, abs=0.1
    )


def test_what_all_depths_share_is_no_error_of_their_difference():
    common = np.full((1, SHAPE[0] // 4, SHAPE[1] // 4), 0.3, np.float32)
    region = step() > 0
    assert errors(common=common).difference_sigma(region).max() == pytest.approx(0, abs=1e-6)
    common[..., :4] = 0
    sigma = errors(common=np.concatenate([common, common])).difference_sigma(region)
    assert sigma[24, 44] == pytest.approx(0, abs=1e-6)
    assert sigma[24, 4] == pytest.approx(0.3 * np.sqrt(2), rel=1e-5), "both are independent"


def test_an_l_filter_takes_long_waves_out():
    """Half of the height of a wave of its cut-off length is left: one with five periods over the width."""
    of, cutoff_px = errors(), SHAPE[1] / 5
    share = of.waves(*SHAPE, l_filter_px=cutoff_px) / of.waves(*SHAPE)
    assert np.sqrt(share[0, 10]) == pytest.approx(0.5, abs=0.02)
    assert share[0, 1] < 1e-3
    assert share[0, 40] > 0.99
