"""Contact of analytic ball presses: where it is known, how noise, specks and the frame's border act on it."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage
from scipy.special import k0

import gelform
from gelform import contact as contact_module
from gelform.background.change import ChangeSettings, PreparedBackground
from gelform.contact import (
    LEAST_NOISE,
    MOST_NOISE,
    contact_from_depth,
    noise_by_place,
)
from kernel_agreement import assert_kernel_agrees

PITCH = 0.0634


def cap(*, center=(160, 120), ball_mm=4.0, depth_mm=0.8):
    """A ball's cap over a plane: its rim is where the depth reaches 0; radius in px beside it."""
    r = from_center(center)
    z = np.sqrt(np.maximum(ball_mm**2 - r**2, 0)) - (ball_mm - depth_mm)
    return np.maximum(z, 0), r / PITCH, np.sqrt(ball_mm**2 - (ball_mm - depth_mm) ** 2) / PITCH


def slopes_noise(shape, sd, seed=0):
    """Depth error of white slope errors: what a color model's noise leaves in the depth."""
    slopes = np.random.default_rng(seed).normal(0, sd, (*shape, 2)).astype(np.float32)
    return gelform.depth_from_gradients(slopes, mm_per_px=PITCH, zero="mean")


def from_center(center=(160, 120)):
    """Distance of each pixel of 240x320, mm."""
    y, x = np.mgrid[:240, :320]
    return np.hypot(x - center[0], y - center[1]) * PITCH


@pytest.mark.parametrize("sd", [0, 0.005, 0.02])
@pytest.mark.parametrize("center", [(160, 120), (5, 120), (300, 230)])
def test_a_cap_keeps_its_radius_under_noise_and_across_the_border(sd, center):
    depth, r, radius = cap(center=center)
    contact = contact_from_depth(depth + slopes_noise(depth.shape, sd), mm_per_px=PITCH)
    assert contact.dtype == bool
    # Without gel beside it the cap ends in a kink, which bends the other way: under noise it takes a pixel of the rim.
    assert contact[r < radius - 3].mean() > 0.98
    assert not contact[r > radius + 2].any()


@pytest.mark.parametrize("length", [0.5, 0.7])
def test_gel_that_is_drawn_down_beside_an_object_is_no_contact(length):
    """A disc pressed flat into a membrane on an elastic bed: depth falls off as Bessel's K0(r / L)."""
    r, edge = from_center((150, 110)), 2.0
    depth = 0.4 * np.where(r < edge, 1, k0(np.maximum(r, edge) / length) / k0(edge / length))
    if length == 0.5:
        contact = contact_from_depth(depth, mm_per_px=PITCH)
        assert contact[r < edge - 0.1].mean() > 0.98
        assert not contact[r > edge + 0.15].any()
        assert depth[r > edge + 0.15].max() > 0.25  # though it is deep there
    noisy, how = 0.5 * depth + slopes_noise(depth.shape, 0.01), {"depth_sigma_mm": np.full(depth.shape, 0.01)}
    contact = contact_from_depth(noisy, mm_per_px=PITCH, relaxation_mm=length, **how)
    assert contact[r < edge - 0.2].mean() > 0.98
    assert not contact[r > edge + 0.2].any()
    too_small = contact_from_depth(noisy, mm_per_px=PITCH, relaxation_mm=0.5 * length, **how)
    assert too_small[r > edge + 0.2].any(), "the gel beside the disc would seem to be held down"


def test_an_outline_under_noise_is_hardly_wider_than_without():
    """A ridge held in a line, beside which the gel falls off: the wide smoothing that noise asks for widens it."""
    x = np.abs(np.arange(320) - 160.0) * PITCH
    depth = np.tile(0.5 * np.exp(-np.maximum(x - 0.2, 0) / 0.5), (240, 1))
    widths = []
    for sd in (0.002, 0.04):
        how = {"relaxation_mm": 0.5, "depth_sigma_mm": np.full(depth.shape, 0.5 * sd)}
        contact = contact_from_depth(depth + slopes_noise(depth.shape, sd), mm_per_px=PITCH, **how)
        widths.append(contact[20:-20].sum(axis=1).mean())
    assert 0.4 / PITCH < widths[0] < 0.4 / PITCH + 4
    assert abs(widths[1] - widths[0]) < 1.5


def test_a_ring_stays_hollow():
    r = from_center()
    depth = np.sqrt(np.maximum(0.8**2 - (r - 3) ** 2, 0.5**2)) - 0.5
    contact = contact_from_depth(depth + slopes_noise(depth.shape, 0.005), mm_per_px=PITCH)
    half = np.sqrt(0.8**2 - 0.5**2)
    assert contact[np.abs(r - 3) < half - 0.1].mean() > 0.99
    assert not contact[np.abs(r - 3) > half + 0.1].any()


def test_a_faint_touch_beside_a_deep_one_is_seen():
    deep, *_ = cap(center=(80, 120))
    faint, r, radius = cap(center=(240, 120), depth_mm=0.02)
    contact = contact_from_depth(deep + faint, mm_per_px=PITCH)
    assert contact[r < 0.7 * radius].all()


def test_nothing_is_found_on_a_gel_at_rest():
    for seed in range(5):
        assert not contact_from_depth(slopes_noise((120, 160), 0.02, seed), mm_per_px=PITCH).any()
    assert not contact_from_depth(np.zeros((24, 32)), mm_per_px=PITCH).any()
    y, x = np.mgrid[:120, :160]
    drift = 0.05 * np.cos(x / 60) * np.sin(y / 50)
    drifted = drift + slopes_noise((120, 160), 0.02)
    sigma = np.full((120, 160), 0.05)
    assert not contact_from_depth(drifted, mm_per_px=PITCH, depth_sigma_mm=sigma).any()


def test_a_noisy_place_is_no_contact_and_hides_none_elsewhere():
    """A sixth of the gel has four times the noise of the rest."""
    touched, *_ = cap(center=(80, 120), depth_mm=0.04)
    noise = np.ones(touched.shape, np.float32)
    noise[:, 270:] = 4.0
    sigma, taken = 0.02 * noise, 0
    for seed in range(4):
        rest = slopes_noise(noise.shape, 0.02 * noise[..., None], seed)
        knows, does_not = (
            contact_module.PreparedContact((PITCH, PITCH), 0.5, n) for n in (noise, np.ones_like(noise))
        )
        assert not knows(rest, sigma).any()
        assert knows((rest + touched).astype(np.float32), sigma)[:, :160].any()
        taken += does_not(rest, sigma).any()
    assert taken > 0


def test_specks_go():
    """A cap of 5 pixels across."""
    depth, _, radius = cap(depth_mm=0.003)
    assert radius < 3
    assert not contact_from_depth(depth, mm_per_px=PITCH, min_area_mm2=0.2).any()
    assert contact_from_depth(depth, mm_per_px=PITCH, min_area_mm2=0.01).any()


def test_pixels_need_not_be_square():
    y, x = np.mgrid[:200, :200]
    r = np.hypot((x - 90) * 0.05, (y - 100) * 0.1)
    depth = np.maximum(np.sqrt(np.maximum(16 - r**2, 0)) - 3.6, 0)
    contact = contact_from_depth(depth, mm_per_px=(0.05, 0.1))
    assert contact[r < 1.55].all()
    assert not contact[r > 1.95].any()


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"mm_per_px": 0}, "mm_per_px > 0"),
        ({"noise_factor": 0}, "noise_factor > 0"),
        ({"relaxation_mm": 0}, "relaxation_mm > 0"),
        ({"min_area_mm2": float("nan")}, "min_area_mm2 >= 0"),
        ({"depth_sigma_mm": np.zeros((7, 8))}, r"depth_sigma_mm of shape \(8, 8\)"),
        ({"depth_mm": np.full((8, 8), np.nan)}, "NaN"),
        ({"depth_mm": np.zeros((2, 8, 8))}, "one frame"),
    ],
)
def test_wrong_depth_and_settings(wrong, text):
    with pytest.raises(ValueError, match=text):
        contact_from_depth(**{"depth_mm": np.zeros((8, 8)), "mm_per_px": PITCH, **wrong})


@pytest.mark.parametrize(("margin", "shape"), [(0, (5, 6)), (2, (17, 21)), (3, (40, 53))])
def test_bending_agrees_with_numpy(margin, shape):
    depth = np.random.default_rng(0).normal(0, 1, shape).astype(np.float32)
    taps = np.array([0.5, 0.2, 0.05], np.float32)

    def by_numpy(depth, taps, smooth, bent, work, along_x, along_y, margin):
        whole = np.concatenate([taps[:0:-1], taps]).astype(float)
        smooth = ndimage.convolve1d(
            ndimage.convolve1d(depth.astype(float), whole, 0, mode="nearest"), whole, 1, mode="nearest"
        )
        bent = -along_x * ndimage.convolve1d(smooth, [1, -2, 1], 1, mode="mirror")
        bent -= along_y * ndimage.convolve1d(smooth, [1, -2, 1], 0, mode="mirror")
        y, x = (np.clip(np.arange(n), margin, n - 1 - margin) for n in smooth.shape)
        return smooth, bent[np.ix_(y, x)]

    blank, work = np.empty_like(depth), np.empty(1000, np.float32)
    assert_kernel_agrees(
        contact_module._bent_surface, by_numpy, depth, taps, blank, blank, work, 2.0, 3.0, margin
    )


@pytest.mark.parametrize("shift", [0.0, -3.0, 5.0])
@pytest.mark.parametrize("step", [1, 3])
def test_noise_agrees_with_numpy(shift, step):
    """Of all magnitudes, in given units or not, and of the depths below 0: where there are none it is 0."""
    values = np.random.default_rng(0).normal(shift, 1, (31, 17)).astype(np.float32)
    units = np.linspace(0.5, 3, values.size, dtype=np.float32).reshape(values.shape)
    work, magnitude = np.empty(2 * 527, np.float32), np.empty(1, np.float32)

    def of_share(values, units, work, magnitude, step, share):
        sample = np.sort(np.abs(values if units is None else values / units).ravel()[::step])
        return sample[[int(share * (sample.size - 1))]]

    def below(values, work, magnitude, step):
        sample = values.ravel()[::step]
        return np.array([-np.median(sample[sample < 0]) if (sample < 0).any() else 0.0])

    for unit in (None, units):
        arguments = values, unit, work, magnitude, step, 0.3
        assert_kernel_agrees(contact_module._magnitude_of_share, of_share, *arguments)
    assert_kernel_agrees(contact_module._median_below, below, values, work, magnitude, step)


@pytest.mark.parametrize("with_sigma", [True, False])
@pytest.mark.parametrize("least", [5, 10_000])
@pytest.mark.parametrize("known", [0.0, 4.0])
def test_pressure_agrees_with_numpy(with_sigma, least, known):
    rng = np.random.default_rng(0)
    depth, bent = (rng.normal(0.2, 0.5, (19, 23)).astype(np.float32) for _ in range(2))
    sigma = rng.uniform(0, 0.2, depth.shape).astype(np.float32) if with_sigma else None

    def by_numpy(sigma, bed, bent, work, known, every_sigma, sigmas, below, least, stiffest):
        bed = np.maximum(bed - sigmas * (every_sigma if sigma is None else sigma), 0)
        falling = (bent < below) & (bed > 0)
        ratio = np.median(-bent[falling] / bed[falling]) if falling.sum() >= least else 0
        stiffness = known or min(ratio, stiffest)
        return bed * stiffness, bent + bed * stiffness

    work = np.empty(2 * depth.size, np.float32)
    for stiffest in (0.1, 25.0):
        arguments = sigma, depth, bent, work, known, 0.1, 2.0, -0.3, least, stiffest
        assert_kernel_agrees(contact_module._pressure_on_bed, by_numpy, *arguments)


# What decides on a region: reach, limit, of_bed, flat, of_flat, half, finer_half, finer_limit, seed, least.
RULES = 4, 0.2, 0.35, 0.4, 0.75, 0.65, 0.6, 2.0, 0.8, 6.0


def regions_by_numpy(pressure, bed, noise, finer, contact, work, *rules):
    reach, limit, of_bed, flat, of_flat, half, finer_half, finer_limit, seed, least = rules
    above = pressure > np.maximum(limit * noise, of_bed * bed)
    window = np.ones(2 * reach + 1)

    def total(values):
        rows = ndimage.convolve1d(values.astype(float), window, 0, mode="constant")
        return ndimage.convolve1d(rows, window, 1, mode="constant")

    def mean_around(values, where):
        return total(where * values) / np.maximum(total(where), 1)

    around = mean_around(pressure, above)
    face = above & (pressure > of_flat * bed) & (bed > flat * around)
    core = ndimage.binary_erosion(face, np.ones((5, 5)), border_value=1)
    found = above & (pressure > half * around) | core
    if finer is not None:
        by_finer = finer + bed
        by_finer_around = mean_around(by_finer, found & (by_finer > of_bed * bed))
        sure = by_finer_around > finer_limit * noise
        found &= core | ~sure | (by_finer > finer_half * by_finer_around)
    labels, count = ndimage.label(found, np.ones((3, 3)))
    large = [
        k
        for k in range(1, count + 1)
        if (labels == k).sum() >= least and (pressure > seed * noise)[labels == k].any()
    ]
    return np.isin(labels, large)


def assert_regions_agree(pressure, bed, noise, finer):
    """Of the kernel and numpy; what they are."""
    maps = pressure, bed, noise, finer, np.empty(pressure.shape, bool), np.empty(40_000, np.float32)
    assert_kernel_agrees(contact_module._contact_regions, regions_by_numpy, *maps, *RULES)
    return regions_by_numpy(*maps, *RULES)


@pytest.mark.parametrize("shape", [(1, 7), (9, 16), (61, 83)])
@pytest.mark.parametrize("with_finer", [False, True])
def test_regions_agree_with_numpy(shape, with_finer):
    rng = np.random.default_rng(3)
    smooth = ndimage.gaussian_filter(rng.normal(0, 6, shape), 1.5)
    pressure = (smooth + 0.2 + rng.normal(0, 0.05, shape)).astype(np.float32)
    bed = np.maximum(ndimage.gaussian_filter(rng.normal(0, 20, shape), 4) + pressure, 0).astype(np.float32)
    finer = (pressure - bed + rng.normal(0, 0.5, shape)).astype(np.float32) if with_finer else None
    assert_regions_agree(pressure, bed, rng.uniform(0.5, 2, shape).astype(np.float32), finer)


def test_a_face_pressed_flat_is_contact_in_its_middle():
    """Every other pixel of it is below half of what it is around; the bed's share of the pressure makes it a contact."""
    pressure = np.zeros((30, 40), np.float32)
    pressure[8:22, 10:30] = np.tile([[0.5, 2.0], [2.0, 0.5]], (7, 10))
    ones = np.ones_like(pressure)
    found = assert_regions_agree(pressure, 0.6 * ones, ones, None)
    assert found[10:20, 12:28].all()
    assert not found[8:22, 10:30].all()


def linear(matrix):
    """Slopes from a color change by a fixed matrix (3, 2)."""
    matrix = np.array(matrix, np.float32)
    return SimpleNamespace(gradients_from_color=lambda change: (change @ matrix, None))


MODEL = linear([[1, 0], [0.3, 2], [0, 0.5]])


def untouched(background):
    return PreparedBackground(background.astype(np.float32), ChangeSettings(method="divide", offset=10.0))


def test_it_is_that_of_many_noisy_images():
    x = np.linspace(60, 200, 96)
    background = np.stack([np.tile(x, (64, 1)), np.tile(x[::-1], (64, 1)), np.full((64, 96), 90.0)], axis=-1)
    levels, rng, prepared = (1.0, 3.0, 2.0), np.random.default_rng(0), untouched(background)
    slopes = [
        MODEL.gradients_from_color(prepared.change(background + rng.normal(0, levels, background.shape)))[0]
        for _ in range(60)
    ]
    columns = np.sqrt(np.mean(np.square(slopes), axis=(0, 1, 3)))
    found = noise_by_place(MODEL, prepared, levels)
    inner = slice(16, -16)  # the map is smooth over 8 px
    np.testing.assert_allclose(found[32, inner], (columns / np.median(columns))[inner], rtol=0.12)
    assert np.median(found) == pytest.approx(1)


def test_noise_of_the_levels_is_taken_to_be_alike_where_it_is_unknown():
    prepared = untouched(np.random.default_rng(0).uniform(60, 200, (40, 50, 3)))
    alike = noise_by_place(MODEL, prepared, (5.0, 5.0, 5.0))
    np.testing.assert_allclose(noise_by_place(MODEL, prepared, None), alike, rtol=1e-3)


def test_it_stays_within_bounds():
    background = np.full((60, 80, 3), 100.0)
    background[:, :10], background[:, 70:] = 0, 255
    found = noise_by_place(linear([[1, 0], [0, 1], [0, 0]]), untouched(background), (1.0, 1.0, 1.0))
    assert LEAST_NOISE <= found.min() < found.max() <= MOST_NOISE
    assert found.dtype == np.float32
    assert (noise_by_place(linear(np.zeros((3, 2))), untouched(background), None) == 1).all()
