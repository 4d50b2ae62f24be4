"""Slope errors that are correlated otherwise at rest than in contact, against Monte Carlo through the door."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gelform.depth import depth_from_gradients
from gelform.depth_sigma.parts import ErrorParts
from gelform.depth_sigma.sigma import DepthSigma

SHAPE, PITCH, SIGMA = (72, 96), 0.2, 0.05
REST = np.hypot(*(np.mgrid[: SHAPE[0], : SHAPE[1]] - np.array([36, 48])[:, None, None])) > 20
ANCHOR = np.where(REST, 1e-2, 0)
SETTINGS = {"correlation_px": 10.0, "correlated_share": 0.7}


def errors(length_px, rng):
    """Slopes (H, W, 2) of variance 1: noise blurred over a short length at rest, over a long one in the contact."""
    noise = rng.standard_normal((*SHAPE, 2))
    if length_px == 0:
        return noise
    blur = length_px / np.sqrt(2)
    return gaussian_filter(noise, (blur, blur, 0), mode="wrap") * (2 * np.sqrt(np.pi) * blur)


@pytest.mark.parametrize("length_px", [0.0, 1.0, 1.8])
def test_short_correlations_at_rest_meet_monte_carlo(length_px):
    rng = np.random.default_rng(1)
    slopes = SIGMA * np.stack(
        [np.where(REST[..., None], errors(length_px, rng), errors(10.0, rng)) for _ in range(250)]
    )
    depth = depth_from_gradients(slopes, mm_per_px=PITCH, anchor=ANCHOR)
    expected = np.sqrt(np.mean(np.square(depth, dtype=np.float64), axis=0))
    prepared = DepthSigma(
        SHAPE, mm_per_px=PITCH, correlation_px=10.0, correlated_share=1.0, rest_correlated_share=0.0,
        rest_correlation_px=length_px,
    )  # fmt: skip
    found = prepared(np.full(SHAPE, SIGMA), anchor=ANCHOR, rest=REST)
    off = np.abs(found / expected - 1)
    assert np.median(off[REST]) < 0.15
    assert np.median(off[~REST]) < 0.15


def test_without_rest_errors_are_as_in_contact_everywhere():
    sigma = np.full(SHAPE, SIGMA)
    plain = DepthSigma(SHAPE, mm_per_px=PITCH, **SETTINGS)
    told = DepthSigma(SHAPE, mm_per_px=PITCH, rest_correlated_share=0.1, rest_correlation_px=1.5, **SETTINGS)
    assert np.array_equal(told(sigma, anchor=ANCHOR), plain(sigma, anchor=ANCHOR))
    nowhere = told(sigma, anchor=ANCHOR, rest=np.zeros(SHAPE, bool))
    assert nowhere == pytest.approx(plain(sigma, anchor=ANCHOR), rel=1e-5)
    by_default = plain(sigma, anchor=ANCHOR, rest=REST)
    assert by_default == pytest.approx(plain(sigma, anchor=ANCHOR), rel=1e-5)


def test_shares_of_the_errors():
    parts = ErrorParts(3, 0.75, 0.0, 0.0)
    assert parts.of_blocks == (0.75, 0.0, 1.0)
    assert parts.within_blocks == pytest.approx([0.5, 1.0])
    assert (ErrorParts(3, 1.0, 1.0, 0.0).within_blocks > 0).all()
    blurred = ErrorParts(3, 0.75, 0.0, 1.5)
    assert blurred.of_blocks[2] > 1 > blurred.within_blocks[1]
