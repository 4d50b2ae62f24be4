"""Contact of analytic ball presses: where it is known, how noise, specks and the frame's border act on it."""

import cv2
import numpy as np
import pytest
from scipy import ndimage
from scipy.special import k0

import gelform
from gelform._native import Kernel
from gelform.depth.contact import PreparedContact, SlopeDeviations, _gains, contact_from_depth, runs_work
from kernel_agreement import assert_kernel_agrees, declarations, drawn

PRESSED_REGIONS = Kernel(
    "pressed_regions",
    "f32[h,w] depth, f32[h,w] sigma, f32[h,w] noise, f32[h,w]? read, f32[h,w]? solved, bool[h,w]? at_rest, "
    "bool[h,w]? known, f32[t] taps, f64[4]? gains, out f32[h,w] smooth, out f32[h,w] bent, out f32[h,w] evidence, "
    "out u16[h,w] labels, out f32[n] work, f32 along_x, f32 along_y, f32 stiffness, f32 factor, f32 reach, i64 margin, "
    "i64 step",
)
STANDING_REGIONS = Kernel(
    "standing_regions",
    "u16[h,w] labels, bool[n] stands, i32[n,2] deepest, f32[h,w] surface, out bool[h,w] contact, i64 reach",
)
# The steps of `pressed_regions`, each by itself.
BENT_SURFACE = Kernel(
    "bent_surface",
    "f32[h,w] depth, f32[t] taps, out f32[h,w] smooth, out f32[h,w] bent, out f32[n] work, f32 along_x, f32 along_y, "
    "i64 margin",
)
MAGNITUDE_OF_SHARE = Kernel(
    "magnitude_of_share",
    "f32[...] values, f32[...] units, bool[...]? chosen, out f32[n] work, out f32[1] magnitude, i64 step, f64 share",
)
SLOPE_VARIANCE = Kernel(
    "slope_variance", "f32[...] read, f32[...] solved, bool[...] at_rest, out f32[...] variance"
)
PRESSURE_MEANS = Kernel(
    "pressure_means",
    "f32[h,w] smooth, f32[h,w] bent, f32[h,w] sigma, f32[h,w] slopes, bool[h,w]? known, out f32[h,w] pressure, "
    "out f32[h,w] mean, out f32[h,w] spread, out f32[h,w] variance, out f32[h,w] mean_bent, out f32[n] work, f32 stiffness, "
    "f32 sigmas",
)
SURE_PRESSURE = Kernel(
    "sure_pressure",
    "f32[...] pressure, f32[...] mean, f32[...] spread, f32[...] sigma, f32[...] slopes, f32[...] noise, "
    "bool[...]? at_rest, bool[...]? known, out f32[...] sure, out f32[...] evidence, "
    "f32 stiffness, f32 factor, f32 mean_gain_at_rest, "
    "f32 mean_gain_elsewhere, f32 gain_at_rest, f32 gain_elsewhere",
)
REGION_EVIDENCE, VARIANCE_BELOW, REGIONS_THAT_STAND = (
    declarations()[name][1] for name in ("region_evidence", "variance_below", "regions_that_stand")
)
CONTACT_OUTLINE = Kernel(
    "contact_outline", "f32[h,w] pressure, out bool[h,w] contact, out f32[n] work, f32 share"
)
HELD_OUTLINE = Kernel(
    "held_outline",
    "bool[h,w] outline, bool[h,w] closed, bool[h,w]? known, f32[h,w] mean, f32[h,w] smooth, f32[h,w] bent, "
    "out bool[h,w] contact, out i32[n] work, f32 stiffness, f32 share, f32 reach",
)

PITCH = 0.0634
CORRELATION = {
    "correlation_px": 6.0, "correlated_share": 0.5, "rest_correlation_px": 1.0, "rest_correlated_share": 0.1,
}  # fmt: skip


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
    # Without gel beside it the cap ends in a kink, which bends the other way and takes pixels of the rim.
    assert contact[r < radius - 5].mean() > 0.98
    assert not contact[r > radius + 2].any()


@pytest.mark.parametrize("length", [0.5, 0.7])
def test_gel_that_is_drawn_down_beside_an_object_is_no_contact(length):
    """A disc pressed flat into a membrane on an elastic bed: depth falls off as Bessel's K0(r / L)."""
    r, edge = from_center((150, 110)), 2.0
    depth = 0.4 * np.where(r < edge, 1, k0(np.maximum(r, edge) / length) / k0(edge / length))
    depth = ndimage.gaussian_filter(depth, 2.2)  # as a camera shows the kink at the edge
    if length == 0.5:
        contact = contact_from_depth(depth, mm_per_px=PITCH)
        assert contact[r < edge - 0.1].mean() > 0.98
        assert not contact[r > edge + 0.2].any()
        assert depth[r > edge + 0.15].max() > 0.25  # though it is deep there
    noisy, how = 0.5 * depth + slopes_noise(depth.shape, 0.01), {"depth_sigma_mm": np.full(depth.shape, 0.01)}
    contact = contact_from_depth(noisy, mm_per_px=PITCH, relaxation_mm=length, **how)
    assert contact[r < edge - 0.2].mean() > 0.98
    assert not contact[r > edge + 0.25].any()
    too_small = contact_from_depth(noisy, mm_per_px=PITCH, relaxation_mm=0.5 * length, **how)
    assert too_small[r > edge + 0.25].any(), "the gel beside the disc would seem to be held down"


def test_an_outline_under_noise_is_hardly_wider_than_without():
    """A ridge held in a line, beside which the gel falls off: the wide smoothing that noise asks for widens it."""
    x = np.abs(np.arange(320) - 160.0) * PITCH
    depth = np.tile(0.5 * np.exp(-np.maximum(x - 0.2, 0) / 0.5), (240, 1))
    widths = []
    for sd in (0.002, 0.04):
        how = {"relaxation_mm": 0.5, "depth_sigma_mm": np.full(depth.shape, 0.5 * sd)}
        contact = contact_from_depth(depth + slopes_noise(depth.shape, sd), mm_per_px=PITCH, **how)
        widths.append(contact[20:-20].sum(axis=1).mean())
    assert 0.4 / PITCH - 1 < widths[0] < 0.4 / PITCH + 4
    assert abs(widths[1] - widths[0]) < 1.5


def flat_disc(half_mm=2.0, length=0.5):
    """A disc pressed flat into a membrane on an elastic bed, as a camera shows it; depth and distance from its center."""
    r = from_center((150, 110))
    depth = 0.3 * np.where(r < half_mm, 1, k0(np.maximum(r, half_mm) / length) / k0(half_mm / length))
    return ndimage.gaussian_filter(depth, 1.0), r


def test_a_flat_face_has_no_holes():
    """Its rim is a line load, beside which the face's own pressure is below the mean around; noise makes holes elsewhere."""
    for sd in (0.0, 0.01):
        depth, r = flat_disc()
        how = {"relaxation_mm": 0.5, "depth_sigma_mm": np.full(depth.shape, 0.002)}
        contact = contact_from_depth(depth + slopes_noise(depth.shape, sd), mm_per_px=PITCH, **how)
        assert contact[r < 1.85].all()
        assert not contact[r > 2.25].any()


def test_a_ring_stays_hollow():
    r = from_center()
    depth = np.sqrt(np.maximum(0.8**2 - (r - 3) ** 2, 0.5**2)) - 0.5
    contact = contact_from_depth(depth + slopes_noise(depth.shape, 0.005), mm_per_px=PITCH)
    half = np.sqrt(0.8**2 - 0.5**2)
    assert contact[np.abs(r - 3) < half - 0.25].mean() > 0.99  # the kink at its rim bends the other way
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
    touched, *_ = cap(center=(80, 120), depth_mm=0.06)
    noise = np.ones(touched.shape, np.float32)
    noise[:, 270:] = 4.0
    sigma, taken = 0.0005 * noise, 0
    for seed in range(4):
        rest = slopes_noise(noise.shape, 0.02 * noise[..., None], seed)
        knows, does_not = (PreparedContact((PITCH, PITCH), 0.5, n) for n in (noise**2, np.ones_like(noise)))
        assert not knows(rest, sigma).any()
        assert knows((rest + touched).astype(np.float32), sigma)[:, :160].any()
        taken += does_not(rest, sigma).any()
    assert taken > 0


def test_pixels_far_from_what_is_known_are_no_contact():
    """Within the gel's relaxation length, unknown pixels are as what is beside them."""
    depth, r, radius = cap()
    known = np.ones(depth.shape, bool)
    known[:, 160:] = False
    sensor = PreparedContact((PITCH, PITCH), 0.5, np.ones(depth.shape, np.float32))
    contact = sensor(depth.astype(np.float32), np.full(depth.shape, 0.01, np.float32), None, known)
    assert contact[(r < radius - 3) & known].mean() > 0.98
    assert contact[120, 160:167].all()
    assert not contact[:, 160 + round(0.5 / PITCH) :].any()


def test_dots_are_contact_within_one_and_nowhere_else():
    """Their slopes are unknown; they hide neither the pressed pixels between them nor the outline."""
    depth, r, radius = cap(ball_mm=4.0, depth_mm=0.8)
    y, x = np.mgrid[: depth.shape[0], : depth.shape[1]]
    known = np.hypot((x - 7) % 16 - 7.5, (y - 5) % 16 - 7.5) > 4
    sigma = np.where(known, 0.02, 10.0).astype(np.float32)
    slopes = SlopeDeviations(sigma, sigma, depth == 0)
    sensor = PreparedContact((PITCH, PITCH), 0.6, np.full(depth.shape, 0.02**2, np.float32), CORRELATION)
    contact = sensor(depth.astype(np.float32), np.full(depth.shape, 0.02, np.float32), slopes, known)
    assert contact[r < radius - 8].mean() > 0.98
    assert contact[r < radius - 4].mean() > 0.9
    assert not contact[r > radius + 2].any()


def test_a_depth_that_is_not_sure_is_no_contact():
    """The same press with a depth that exceeds its own deviation by far, and hardly."""
    depth, *_ = cap(depth_mm=0.3)
    for sigma, found in ((0.02, True), (0.12, False)):
        how = {"mm_per_px": PITCH, "depth_sigma_mm": np.full(depth.shape, sigma)}
        assert contact_from_depth(depth, **how).any() == found
        assert not contact_from_depth(-depth, **how).any()


@pytest.mark.parametrize("dots", [False, True])
def test_a_contact_of_the_background_is_told_by_its_valley(dots):
    """Not beside a deeper contact, not where sigma covers it, and not of the depth's errors."""
    depth, *_ = cap(depth_mm=0.3)
    y, x = np.mgrid[: depth.shape[0], : depth.shape[1]]
    known = np.hypot((x - 7) % 16 - 7.5, (y - 5) % 16 - 7.5) > 4 if dots else np.ones(depth.shape, bool)
    sensor = PreparedContact((PITCH, PITCH), 0.6, np.full(depth.shape, 0.02**2, np.float32), CORRELATION)

    def findings(depth, sigma_mm, touched=False):
        sigma = np.where(known, 0.02, 10.0).astype(np.float32)
        slopes = SlopeDeviations(sigma, sigma, depth == 0)
        depth_sigma = np.full(depth.shape, sigma_mm, np.float32)
        return sensor.pressed_background(
            depth.astype(np.float32), depth_sigma, slopes, known, touched=touched
        )

    (found,) = findings(-depth, 0.01)
    assert found.name == "background_pressed"
    assert found.figure == pytest.approx(0.3, abs=0.01)
    assert not findings(depth, 0.01)
    assert not findings(-depth, 0.07)  # 4.3 sigma
    deeper, *_ = cap(center=(40, 40), depth_mm=0.4)
    assert not findings(deeper - depth, 0.01)
    at_border, *_ = cap(center=(0, depth.shape[0] // 2), depth_mm=0.3)
    assert findings(-at_border, 0.01)
    assert not findings(-at_border, 0.01, touched=True), "a border that sinks while something touches"
    assert findings(-depth, 0.01, touched=True)
    assert not findings(-0.05 - slopes_noise(depth.shape, 0.02), 0.02)


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
    assert contact[r < 1.3].all()  # the kink at its rim takes 4 px
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


def test_bending_agrees_with_numpy():
    def by_numpy(depth, taps, smooth, bent, work, along_x, along_y, margin):
        whole, smooth = np.concatenate([taps[:0:-1], taps]).astype(float), depth.astype(float)
        for axis in (0, 1):
            smooth = ndimage.convolve1d(smooth, whole, axis, mode="nearest")
        bent = -along_x * ndimage.convolve1d(smooth, [1, -2, 1], 1, mode="mirror")
        bent -= along_y * ndimage.convolve1d(smooth, [1, -2, 1], 0, mode="mirror")
        y, x = (np.clip(np.arange(n), margin, n - 1 - margin) for n in smooth.shape)
        return smooth, bent[np.ix_(y, x)]

    assert_kernel_agrees(BENT_SURFACE, by_numpy)


def test_noise_agrees_with_numpy():
    """Of all magnitudes or chosen ones: where there are none it is 0."""

    def of_share(values, units, chosen, work, magnitude, step, share):
        taken = slice(None) if chosen is None else chosen.ravel()[::step]
        sample = np.sort((np.abs(values) / np.sqrt(units)).ravel()[::step][taken])
        return sample[[int(share * (sample.size - 1))]] if sample.size else np.zeros(1)

    assert_kernel_agrees(MAGNITUDE_OF_SHARE, of_share)


def around(values):
    """Sums over the squares of 9 x 9 pixels around each pixel; there is nothing outside of the frame."""
    for axis in (0, 1):
        values = ndimage.convolve1d(values.astype(float), np.ones(9), axis, mode="constant")
    return values


def test_means_of_the_pressure_agree_with_numpy():
    def by_numpy(smooth, bent, sigma, slopes, known, pressure, mean, spread, variance, mean_bent, *rest):
        stiffness, sigmas = rest[-2:]
        seen = np.ones(smooth.shape) if known is None else known.astype(float)
        pressure = seen * (bent + stiffness * np.maximum(smooth - sigmas * sigma, 0))
        mean, square, slopes, bent = (
            around(one) / np.maximum(around(seen), 1)
            for one in (pressure, pressure**2, seen * slopes, seen * bent)
        )
        lost = around(np.ones(seen.shape)) / np.maximum(around(seen), 1)
        return pressure, mean, np.maximum(square - mean**2, 0), slopes * lost**2, bent

    assert_kernel_agrees(PRESSURE_MEANS, by_numpy)


def test_the_sure_pressure_agrees_with_numpy():
    def by_numpy(pressure, mean, spread, sigma, slopes, noise, rest, known, sure, evidence, *numbers):
        stiffness, factor, mean_rest, mean_else, one_rest, one_else = numbers
        bed, mean = (stiffness * sigma.astype(float)) ** 2, np.maximum(mean, 0)
        own = np.maximum(1 - 2 * noise * one_rest / np.maximum(spread, 1e-30), 0)
        q = np.maximum(mean + own * (pressure - mean), 0)
        rest = np.ones(mean.shape, bool) if rest is None else rest
        of_mean, of_one = np.where(rest, mean_rest, mean_else), np.where(rest, one_rest, one_else)
        variance = slopes * of_mean + bed
        counts = (
            (True if known is None else known)
            & (mean > np.sqrt(variance))
            & (mean > factor * np.sqrt(noise * mean_rest))
        )
        counts &= q**2 > slopes * (own**2 * of_one + (1 - own) ** 2 * of_mean) + bed
        counts &= q > factor * np.sqrt(noise * (own**2 * one_rest + (1 - own) ** 2 * mean_rest))
        return np.where(counts, q, 0), mean**2 / variance

    assert_kernel_agrees(SURE_PRESSURE, by_numpy)
    arguments = drawn(SURE_PRESSURE, np.random.default_rng(0), 1)
    assert SURE_PRESSURE(*arguments) == np.count_nonzero(arguments[8]) > 0


def test_slope_variance_agrees_with_numpy():
    """As read at rest, as solved elsewhere; a slope that is not known at all has a variance of 0.3."""

    def by_numpy(read, solved, rest, variance):
        return np.minimum(np.where(rest, read, solved).astype(float) ** 2, 0.3)

    assert_kernel_agrees(SLOPE_VARIANCE, by_numpy)


def test_held_outlines_agree_with_numpy():
    """Gaps that are closed and pressed, then holes whose pressure is more than a part of the bed's."""
    rng = np.random.default_rng(0)
    outline, closed = rng.random((2, 19, 23)) < 0.5
    mean, smooth, bent = rng.normal(0.2, 0.5, (3, 19, 23)).astype(np.float32)

    def by_numpy(outline, closed, known, mean, smooth, bent, contact, work, stiffness, share, reach):
        above = np.maximum(smooth, 0)
        found = outline | (closed & (mean > share * stiffness * above))
        labels, count = ndimage.label(~found)
        around = np.unique(np.r_[labels[0], labels[-1], labels[:, 0], labels[:, -1]])
        for k in set(range(1, count + 1)) - set(around.tolist()):
            hole = labels == k
            found |= hole & ((bent[hole] + (1 - share) * stiffness * above[hole]).sum() > 0)
        return found

    work = np.empty(runs_work(outline.shape), np.int32)
    arguments = outline, closed, None, mean, smooth, bent, np.empty_like(outline), work, 0.9, 0.4, 5.0
    assert_kernel_agrees(HELD_OUTLINE, by_numpy, *arguments)
    assert (by_numpy(*arguments) & ~outline & ~closed).any(), "no hole was filled"


@pytest.mark.parametrize("shape", [(1, 7), (14, 1), (40, 53)])
def test_unknown_pixels_are_as_the_nearest_known_one(shape):
    rng = np.random.default_rng(1)
    known = ndimage.gaussian_filter(rng.normal(size=shape), 0.7) > -0.25
    pressed = (ndimage.gaussian_filter(rng.normal(size=shape), 2) > 0) & known
    contact, flat = np.empty(shape, bool), np.zeros(shape, np.float32)
    work = np.empty(runs_work(shape), np.int32)
    HELD_OUTLINE(pressed, np.zeros(shape, bool), known, flat, flat, flat - 1, contact, work, 1.0, 0.5, 2.4)
    y, x = np.indices(shape)

    def far(chosen: np.ndarray) -> np.ndarray:
        """Distance to the nearest chosen pixel, where an edge is 3 and a corner 4."""
        across = np.abs(np.stack([y[..., None] - y[chosen], x[..., None] - x[chosen]]))
        return (4 * across.min(0) + 3 * (across.max(0) - across.min(0))).min(axis=-1, initial=10**6)

    inside, outside = far(pressed), far(known & ~pressed)
    assert contact[(inside < outside) & (inside <= 3 * 2.4)].all()
    assert not contact[(inside > outside) | (inside > 3 * 2.4)].any()
    assert ((~known).any() and (contact & ~known).any()) or min(shape) == 1


@pytest.mark.parametrize("knows", [False, True])
@pytest.mark.parametrize("shape", [(60, 83), (61, 96)])
def test_the_regions_are_those_of_the_steps_by_themselves(knows, shape):
    """Rough flat faces with gaps of a pixel or two, which are closed as OpenCV closes them."""
    rng = np.random.default_rng(3)
    y, x = np.indices(shape)
    faces = 0.3 * (np.hypot(y % 30 - 15, x % 30 - 15) < 11) * (x % 13 > 1)
    depth = (faces + 0.05 * ndimage.gaussian_filter(rng.normal(size=shape), 1)).astype(np.float32)
    known, at_rest = rng.random(shape) > 0.05, faces == 0
    sigma, read = (np.full(shape, one, np.float32) for one in (0.01, 0.02))
    noise = np.full(shape, 1e-3, np.float32)
    sensor = PreparedContact((PITCH, PITCH), 0.5, noise, CORRELATION if knows else None)
    smooth, bent, evidence, sure, variance = (np.zeros(shape, np.float32) for _ in range(5))
    labels, work = np.zeros(shape, np.uint16), np.empty(sensor._work_size, np.float32)
    of_slopes = (read, 2 * read, at_rest) if knows else (None, None, None)
    numbers = {p.name: sensor._numbers[p.name] for p in PRESSED_REGIONS.parameters[14:]}
    count = PRESSED_REGIONS(
        depth, sigma, sensor._noise, *of_slopes, known, sensor._taps, sensor._gains, smooth, bent, evidence, labels, work,
        **numbers,
    )  # fmt: skip
    stiffness, factor, reach = (numbers[name] for name in ("stiffness", "factor", "reach"))
    if knows:
        SLOPE_VARIANCE(*of_slopes, variance)
    else:
        variance[...] = sensor._noise
    pressure, mean, spread, around, mean_bent = (np.empty(shape, np.float32) for _ in range(5))
    PRESSURE_MEANS(
        smooth, bent, sigma, variance, known, pressure, mean, spread, around, mean_bent, work, stiffness, 2.0
    )
    gains = []
    for k, values in ((0, mean_bent), (2, bent)):
        found, how = np.empty(1, np.float32), (numbers["step"], 0.95 if knows else 0.3)
        MAGNITUDE_OF_SHARE(values, sensor._noise, at_rest if knows else None, work, found, *how)
        if knows:
            gains += [max(sensor._gains[k], (float(found[0]) / 1.96) ** 2), sensor._gains[k + 1]]
        else:
            gains += 2 * [max(2.595 * float(found[0]), 1e-3) ** 2]
    rest, again = at_rest if knows else None, np.empty(shape, np.float32)
    SURE_PRESSURE(
        pressure,
        mean,
        spread,
        sigma,
        around,
        sensor._noise,
        rest,
        known,
        sure,
        again,
        stiffness,
        factor,
        *gains,
    )
    outline, contact = np.empty((2, *shape), bool)
    CONTACT_OUTLINE(sure, outline, work, 2 / 3)
    closed = cv2.morphologyEx(outline.view(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)).view(bool)
    runs = np.empty(runs_work(shape), np.int32)
    HELD_OUTLINE(outline, closed, known, mean, smooth, bent, contact, runs, stiffness, 0.5, reach)
    np.testing.assert_array_equal(labels > 0, contact)
    np.testing.assert_array_equal(evidence, again)
    assert count == ndimage.label(contact, np.ones((3, 3)))[1] > 0
    assert (closed & ~outline).any()


@pytest.mark.parametrize("alone", [None, 0.05])
def test_the_contact_is_that_of_its_steps(alone):
    """Of three caps of other depths, whose deviations let one, two or three stand."""
    depth = np.float32(
        sum(cap(center=(x, 60), depth_mm=d)[0] for x, d in ((60, 0.8), (160, 0.3), (260, 0.1)))
    )
    sensor = PreparedContact((PITCH, PITCH), 0.5, np.full(depth.shape, 1e-3, np.float32))
    smooth, bent, evidence = np.empty((3, *depth.shape), np.float32)
    labels, work, own = (
        np.empty(depth.shape, np.uint16),
        np.empty(sensor._work_size, np.float32),
        np.float32(0.01),
    )
    numbers, found = sensor._numbers, set()
    outline = np.full_like(depth, own)
    count = PRESSED_REGIONS(
        depth, outline, sensor._noise, None, None, None, None, sensor._taps, None, smooth, bent, evidence, labels, work,
        **{p.name: numbers[p.name] for p in PRESSED_REGIONS.parameters[14:]},
    )  # fmt: skip
    variance = None if alone is None else np.full((2, 2), alone**2, np.float32)
    for sigma_mm in (0.005, 0.03, 0.1, 0.3):
        sigma = np.full_like(depth, sigma_mm)
        measures, excess = np.empty((count, 7)), np.empty(1)
        stands, deepest = np.empty(count + 1, bool), np.empty((count + 1, 2), np.int32)
        maps = sigma, evidence, smooth, bent, sensor._influence
        REGION_EVIDENCE(labels, depth, *maps, measures, numbers["stiffness"], 1, 1)
        VARIANCE_BELOW(depth, sigma, excess, numbers["step"])
        how = excess.item(), numbers["least"], numbers["factor"], 9.0
        REGIONS_THAT_STAND(measures, variance, stands, deepest, *how, *depth.shape)
        wanted = np.empty(depth.shape, bool)
        STANDING_REGIONS(labels, stands, deepest, depth, wanted, numbers["join"])
        if alone is None:
            contact = sensor._contact(depth, np.stack([sigma, outline]), None, None)
        else:
            variances = np.stack(
                [np.full((2, 2), one, np.float32) for one in (sigma_mm**2, own**2, alone**2)]
            )
            contact, stood = sensor.judged(depth, variances, 9.0, None)
            np.testing.assert_allclose(stood, sigma_mm, rtol=1e-6)
        np.testing.assert_array_equal(contact, wanted)
        found.add(int(stands.sum()))
    assert found == ({0, 1, 2, 3} if alone is None else {1, 2, 3})


def test_outlines_agree_with_numpy():
    def by_numpy(pressure, contact, work, share):
        return pressure * around(pressure > 0) > share * around(pressure)

    assert_kernel_agrees(CONTACT_OUTLINE, by_numpy)


def test_the_mask_is_that_of_the_regions_that_stand():
    labels = np.random.default_rng(0).integers(0, 5, (13, 17)).astype(np.uint16)
    stands, deepest = np.array([False, True, False, True, False]), np.zeros((5, 2), np.int32)

    def by_numpy(labels, stands, deepest, surface, contact, reach):
        return stands[labels]

    flat, contact = np.zeros(labels.shape, np.float32), np.empty(labels.shape, bool)
    assert_kernel_agrees(STANDING_REGIONS, by_numpy, labels, stands, deepest, flat, contact, 4)


@pytest.mark.parametrize(("valley", "stands", "count"), [(0.0, True, 1), (0.5, True, 2), (0.0, False, 1)])
def test_regions_of_one_hill_are_joined_up_its_slope(valley, stands, count):
    """Two regions with a gap between; the lower one's way up leads into the higher one, or to a summit of its own."""
    y, x = np.mgrid[:40, :80]
    surface = np.exp(-((x - 50.0) ** 2 + (y - 20) ** 2) / 500) - valley * (np.abs(x - 35) < 3)
    labels = 1 * (np.abs(y - 20) + np.abs(x - 55) < 12) + 2 * (np.hypot(y - 20, x - 25) < 5)
    lower = np.unravel_index(np.argmax(np.where(labels == 2, surface, -9)), labels.shape)
    regions = labels.astype(np.uint16), np.array([False, True, stands])
    deepest, contact = np.array([(0, 0), (20, 50), lower], np.int32), np.empty(labels.shape, bool)
    STANDING_REGIONS(*regions, deepest, surface.astype(np.float32), contact, 0)
    assert contact[labels == 1].all()
    assert contact[labels == 2].all() == stands
    assert ndimage.label(contact, np.ones((3, 3)))[1] == count
    assert np.count_nonzero(contact & (labels == 0)) <= 20


def test_the_pressure_s_variance_is_that_of_noisy_slopes():
    """White noise of slopes, integrated, smoothed and bent again; and noise that is correlated over some pixels."""
    rng, shape = np.random.default_rng(0), (200, 220)
    for blur, averaged in ((0.0, False), (0.0, True), (6.0, False), (6.0, True)):
        slopes = rng.normal(0, 1, (*shape, 2))
        if blur:
            slopes = ndimage.gaussian_filter(slopes, (blur, blur, 0)) * 2 * np.sqrt(np.pi) * blur
        length = np.sqrt(2) * blur  # the correlation of a blurred white noise falls to exp(-1/2) there
        smoothing = np.hypot(0.7, np.sqrt(80 / 12) if averaged else 0)
        noise = length, 1.0 if blur else 0.0, 0.0, None
        at_rest, elsewhere = _gains((PITCH, PITCH), [smoothing], *noise)
        assert at_rest == elsewhere
        depth = gelform.depth_from_gradients(0.01 * slopes.astype(np.float32), mm_per_px=PITCH)
        bent = -ndimage.laplace(ndimage.gaussian_filter(depth, 0.7)) / PITCH**2
        bent = ndimage.uniform_filter(bent, 9) if averaged else bent
        # The five points of a Laplacian blur white noise, too.
        assert np.var(bent[40:-40, 40:-40]) / 0.01**2 == pytest.approx(at_rest, rel=0.35)
