"""Areal roughness of surfaces whose figures are known, and against the standard's formulas written out."""

import numpy as np
import pytest
from scipy import integrate

from gelform.result.metrics import areal_roughness
from gelform.result.metrics.roughness import gaussian_areal_filter

PITCH = 0.02
SHAPE = (200, 250)  # whole waves of 25 and 50 px
PLAIN = {"mm_per_px": PITCH, "form": "none", "s_filter_mm": None, "l_filter_mm": None}
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]] * PITCH


def wave(amplitude_mm=0.01, length_px=50):
    return amplitude_mm * np.sin(2 * np.pi * X / (length_px * PITCH) + 0.3)


def test_a_sinusoid():
    found, amplitude_um = areal_roughness(wave(), **PLAIN), 10.0
    assert found.Sa_um == pytest.approx(2 * amplitude_um / np.pi, rel=2e-3)
    assert found.Sq_um == pytest.approx(amplitude_um / np.sqrt(2), rel=1e-6)
    assert found.Sz_um == pytest.approx(2 * amplitude_um, rel=2e-3)
    assert found.Ssk == pytest.approx(0, abs=1e-6)
    assert found.Sku == pytest.approx(1.5, rel=1e-6)
    assert found.area_mm2 == pytest.approx(SHAPE[0] * SHAPE[1] * PITCH**2)


def test_the_area_of_a_steep_sinusoid():
    """Its arc length, an elliptic integral."""
    amplitude, length = 0.2, 1.0
    slope = 2 * np.pi * amplitude / length
    arc, _ = integrate.quad(lambda t: np.sqrt(1 + (slope * np.cos(t)) ** 2), 0, 2 * np.pi)
    found = areal_roughness(wave(amplitude), **PLAIN)
    assert found.Sdr_percent == pytest.approx(100 * (arc / (2 * np.pi) - 1), rel=5e-3)


def test_a_tilted_plane_has_the_area_of_its_slope_and_no_height_once_it_is_removed():
    plane = 0.3 * X + 0.4 * Y
    assert areal_roughness(plane, **PLAIN).Sdr_percent == pytest.approx(100 * (np.sqrt(1.25) - 1))
    found = areal_roughness(plane, **{**PLAIN, "form": "plane"})
    assert max(found.Sa_um, found.Sz_um, found.Sdr_percent) < 1e-6


def test_two_levels():
    """A step at a quarter: Sq, skewness and kurtosis of a coin with chances 1/4 and 3/4."""
    found = areal_roughness(np.where(SHAPE[0] * PITCH / 4 > Y, 0.04, 0.0), **PLAIN)
    chance = 0.25
    spread = np.sqrt(chance * (1 - chance))
    assert found.Sq_um == pytest.approx(40 * spread)
    assert found.Sa_um == pytest.approx(2 * 40 * chance * (1 - chance))
    assert found.Ssk == pytest.approx((1 - 2 * chance) / spread)
    assert found.Sku == pytest.approx(1 + (1 - 2 * chance) ** 2 / spread**2)


PASSED = [
    ({"s_filter_mm": 1.0}, 0.5),
    ({"l_filter_mm": 1.0}, 0.5),
    ({"s_filter_mm": 0.5}, 0.5**0.25),
    ({"l_filter_mm": 2.0}, 1 - 0.5**4),
]


def test_a_wave_of_the_cutoffs_length_keeps_half_of_its_height():
    """The transmission of ISO 16610-61 is exp(-pi (alpha cutoff / length)^2); measured away from the ends."""
    for filters, passed in PASSED:
        wide = np.tile(wave(), (1, 3))
        middle = np.zeros(wide.shape, dtype=bool)
        middle[:, SHAPE[1] : 2 * SHAPE[1]] = True
        cutoff = next(iter(filters.values())) / PITCH
        low = gaussian_areal_filter(wide, cutoff, np.ones(wide.shape, dtype=bool))
        kept = low if "s_filter_mm" in filters else wide - low
        assert kept[middle].std() / wide[middle].std() == pytest.approx(passed, rel=2e-3)


def test_against_the_standards_weights_summed_pixel_by_pixel():
    """A rough patch with an odd outline: the same figures by sums that share nothing with the code."""
    rng, shape, cutoff = np.random.default_rng(1), (34, 30), 9.0
    y, x = np.mgrid[: shape[0], : shape[1]]
    heights = 0.01 * rng.normal(size=shape) + 1e-4 * (x - 12) ** 2 + 2e-3 * y
    mask = np.hypot(x - 14, (y - 16) / 1.2) < 13
    alpha = 0.4697186
    low = np.zeros(shape)
    for row, col in zip(*np.nonzero(mask)):
        weight = np.exp(-np.pi * ((x - col) ** 2 + (y - row) ** 2) / (alpha * cutoff) ** 2) * mask
        low[row, col] = (weight * heights).sum() / weight.sum()
    residual = heights[mask] - low[mask]
    residual -= residual.mean()
    settings = {**PLAIN, "l_filter_mm": cutoff * PITCH}
    found = areal_roughness(heights, mask=mask, **settings)
    assert found.Sq_um == pytest.approx(1e3 * residual.std(), rel=1e-4)
    assert found.Sa_um == pytest.approx(1e3 * np.abs(residual).mean(), rel=1e-4)
    assert found.Sku == pytest.approx((residual**4).mean() / residual.var() ** 2, rel=1e-4)


def test_the_roughness_of_a_ball_is_that_of_its_face():
    """Form and waviness of a cap go, a fine wave on it stays."""
    cap = np.sqrt(15.0**2 - (X - X.mean()) ** 2 - (Y - Y.mean()) ** 2)
    fine = wave(0.004, 25)
    settings = {"mm_per_px": PITCH, "l_filter_mm": 2.5}
    assert areal_roughness(cap, **settings).Sq_um < 0.05 * 4 / np.sqrt(2)
    both = areal_roughness(cap + fine, **settings)
    assert both.Sq_um == pytest.approx(areal_roughness(fine, **settings).Sq_um, rel=0.02)
    assert (both.form, both.l_filter_mm) == ("quadratic", 2.5)
    assert both.s_filter_mm == pytest.approx(3 * PITCH)


def test_a_flat_surface_has_no_roughness():
    found = areal_roughness(np.full(SHAPE, 0.7), **PLAIN)
    assert (found.Sa_um, found.Sq_um, found.Sku, found.Sdr_percent) == (0, 0, 0, 0)


def test_refused():
    for wrong, said in [
        ({"form": "cubic"}, "Expected a form among none, plane, quadratic"),
        ({"mask": np.ones((2, 2), dtype=bool)}, "Expected mask of shape"),
        ({"mask": np.zeros(SHAPE, dtype=bool)}, "at least 100 pixels"),
        ({"s_filter_mm": 3.0, "l_filter_mm": 2.5}, "Expected the L-filter above"),
        ({"l_filter_mm": -1.0}, "l_filter_mm"),
        ({"depth_mm": np.zeros((2, *SHAPE))}, r"shape \(H, W\)"),
    ]:
        arguments = {"depth_mm": wave(), "mm_per_px": PITCH, **wrong}
        with pytest.raises(ValueError, match=said):
            areal_roughness(arguments.pop("depth_mm"), **arguments)


def gaussian_field(correlation_px, sigma_mm, seed):
    """A periodic Gaussian random field whose covariance is sigma^2 exp(-(r / correlation)^2), by its spectrum."""
    rng, shape = np.random.default_rng(seed), (512, 512)
    frequency = 2 * np.pi * np.hypot(*np.meshgrid(*map(np.fft.fftfreq, shape), indexing="ij"))
    filtered = np.fft.fft2(rng.normal(size=shape)) * np.exp(-((correlation_px * frequency) ** 2) / 8)
    field = np.fft.ifft2(filtered).real
    expected = np.sqrt(np.mean(np.exp(-((correlation_px * frequency) ** 2) / 4)))
    return sigma_mm * field / expected


def test_a_gaussian_random_field():
    """Sa = Sq sqrt(2/pi), Ssk = 0, Sku = 3; slopes are normal of variance 2 (sigma / correlation)^2 each way, whence Sdr."""
    sigma, correlation_px = 0.02, 12.0
    heights = gaussian_field(correlation_px, sigma, seed=3)
    found = areal_roughness(heights, **PLAIN)
    assert found.Sq_um == pytest.approx(1e3 * sigma, rel=0.03)
    assert found.Sa_um / found.Sq_um == pytest.approx(np.sqrt(2 / np.pi), rel=0.01)
    assert (found.Ssk, found.Sku) == pytest.approx((0, 3), abs=0.12)
    variance = 2 * (sigma / (correlation_px * PITCH)) ** 2

    def stretched(slope):  # whose square is exponential of mean 2 x variance
        return (np.sqrt(1 + slope**2) - 1) * slope / variance * np.exp(-(slope**2) / (2 * variance))

    expected, _ = integrate.quad(stretched, 0, 20 * np.sqrt(variance))
    assert found.Sdr_percent == pytest.approx(100 * expected, rel=0.03)
