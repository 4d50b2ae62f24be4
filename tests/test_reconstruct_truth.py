"""The steps of a frame, each held to a gel that is known exactly: take one out, and a test here fails."""

import pickle
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import gelform
from gelform.result.maps import MAPS
from gelform.slopes.color_models.physical import LambertianModel
from made.small_gel import LIGHTS, SHAPE, Touch, background, calibration, depth_of, image_of, stepping

TOUCH = Touch(depth_mm=0.4, x_px=40, y_px=32)
TRUTH = depth_of(TOUCH)
TOUCHED = TRUTH > 0.02


@pytest.fixture(scope="module")
def reconstruct():
    return gelform.Reconstructor(calibration())


def error_um(result):
    return 1e3 * float(np.sqrt(np.mean((result.depth_mm - TRUTH) ** 2)))


def test_depth_of_a_ball_to_a_few_micrometers(reconstruct):
    """And untouched gel is held at 0."""
    result = reconstruct(image_of(TOUCH))
    assert error_um(result) < 5
    assert result.health == ()
    assert result.known.all()
    assert result.contact[TRUTH > 0.25].all()
    assert not result.contact[TRUTH == 0].any()
    far = np.hypot(*(np.indices(SHAPE) - np.array([32, 40])[:, None, None])) > 28
    assert np.abs(result.depth_mm[far]).max() < 0.008
    assert abs(np.median(result.depth_mm[far])) < 0.002


def test_light_that_is_added_everywhere_is_no_slope(reconstruct):
    """Room light adds gray levels and multiplies none: what the exposure leaves of it is taken out as a bias."""
    for color in [(3.0, 0.0, 0.0), (0.0, -3.0, 3.0)]:
        lit = np.clip(image_of(TOUCH) + np.array(color), 0, 255).astype(np.float32)
        result = reconstruct(lit)
        assert error_um(result) < 12
        assert np.abs(np.median(result.observed_gradients[TRUTH == 0], axis=0)).max() < 1e-4


class Tilted(LambertianModel):
    """A color model that reads a slope of rest: the lights have moved a little since."""

    def prepare(self, background, shape):
        exact, off = super().prepare(background, shape).gradients_from_color, np.float32([0.04, -0.03])
        return SimpleNamespace(gradients_from_color=lambda change: (exact(change)[0] + off, None))


def test_slopes_that_are_read_at_rest_are_taken_off_everywhere():
    result = gelform.Reconstructor(replace(calibration(), color_model=Tilted(LIGHTS)))(image_of(TOUCH))
    assert error_um(result) < 15
    assert np.abs(np.median(result.observed_gradients[TRUTH == 0], axis=0)).max() < 1e-3


def test_albedo_is_that_of_the_gel(reconstruct):
    """A stain that takes the same share of all three lights is no slope."""
    stained = image_of(None).astype(np.float32)
    stained[20:30, 30:50] *= 0.85
    result = reconstruct(stained)
    reconstruct(image_of(TOUCH))  # it is that of its own frame, whenever it is asked for
    assert result.albedo.shape == SHAPE
    assert result.albedo[22:28, 32:48].mean() == pytest.approx(0.85, abs=0.01)
    assert result.albedo[40:].mean() == pytest.approx(1.0, abs=0.01)
    assert np.abs(result.depth_mm).max() < 0.02


DOTS = np.all((np.indices(SHAPE) - 4) % 10 < 4, axis=0) & np.all(np.indices(SHAPE) > 3, axis=0)


def with_dots(image, share=0.3, right_px=0):
    """Dark dots, 4 px wide, on a square grid of 10 px, of a share of the light around them; their ink is not gray."""
    light = np.where(np.roll(DOTS, right_px, axis=1)[..., None], share * np.array([0.7, 1.0, 1.3]), 1)
    return (image * light).astype(np.asarray(image).dtype)


@pytest.fixture(scope="module")
def marked():
    return gelform.Reconstructor(replace(calibration(), background=with_dots(background())))


def test_markers_have_no_confidence_and_leave_no_dents(marked):
    result = marked(with_dots(image_of(TOUCH), right_px=1))
    dots = (with_dots(np.ones((*SHAPE, 3)), right_px=1) < 1).all(axis=-1)
    assert result.confidence[dots].max() < 1e-5
    assert result.confidence[~dots].max() == 1
    assert error_um(result) < 40
    assert np.abs(result.depth_mm - TRUTH).max() < 0.15
    assert result.gradients_sigma[dots].min() > 2 * np.median(result.gradients_sigma[~dots])


def test_markers_that_moved_are_no_contact(marked):
    """Where a dot was and where it is, colors changed as if by steep slopes: nothing touches."""
    result = marked(with_dots(background(), right_px=1))
    assert np.abs(result.depth_mm).max() < 0.005
    assert not result.contact.any()


def test_marker_dots_stay_where_they_were_found_when_pickled(marked):
    """Dots are sought from where the first background has them, also after another one was taken."""
    image = with_dots(image_of(TOUCH), right_px=1)
    taken = marked.with_background(with_dots(background(), right_px=1).astype(np.float32))
    for one in (marked, taken):
        again = pickle.loads(pickle.dumps(one))
        np.testing.assert_array_equal(again.markers.rest_px, marked.markers.rest_px)
        result, expected = again.from_image(image), one.from_image(image)
        np.testing.assert_array_equal(result.markers.now_px, expected.markers.now_px)
        np.testing.assert_array_equal(result.depth_mm, expected.depth_mm)
    assert len(marked.markers)


def test_depth_does_not_depend_on_how_dark_markers_are(marked):
    paler = gelform.Reconstructor(replace(calibration(), background=with_dots(background(), 0.45)))
    dark, pale = marked(with_dots(image_of(TOUCH), 0.3, 1)), paler(with_dots(image_of(TOUCH), 0.45, 1))
    np.testing.assert_allclose(pale.depth_mm, dark.depth_mm, atol=0.01)


def test_saturated_pixels_are_filled_from_around(reconstruct):
    """A glare: weights keep it from the rest. Without them depth is 60 um off."""
    for box in [np.s_[28:40, 46:60], np.s_[10:20, 55:75]]:
        glare = image_of(TOUCH)
        glare[box] = 255
        result = reconstruct(glare)
        assert result.confidence[box].max() < 0.01
        assert result.gradients_sigma[box].min() >= 0.999
        assert error_um(result) < 10
        np.testing.assert_array_equal(reconstruct.explain(glare).confidence, result.confidence)


def test_without_a_scale_depth_is_in_pixels_and_without_sigma_nothing_is_said_of_it():
    """As in a calibration that another program wrote."""
    unscaled = gelform.Reconstructor(replace(calibration(), mm_per_px=None, mm_per_px_sigma=None))
    result = unscaled(image_of(TOUCH))
    np.testing.assert_allclose(0.1 * result.depth_px, TRUTH, atol=0.02)
    assert result.depth_sigma_mm is None
    result = gelform.Reconstructor(replace(calibration(), slope_sigma=None))(image_of(TOUCH))
    assert error_um(result) < 10
    assert result.depth_sigma_mm is None
    assert result.gradients_sigma is None


class Stating(LambertianModel):
    """A color model that states the deviation of its slopes: 0.04 along x and less along y, 0.5 in the leftmost columns."""

    def prepare(self, background, shape):
        exact = super().prepare(background, shape).gradients_from_color
        sigma = np.full((*shape, 2), (0.04, 0.01), np.float32)
        sigma[:, :20] = 0.5
        return SimpleNamespace(gradients_from_color=lambda change: (exact(change)[0], sigma))


def test_a_deviation_that_the_color_model_states_counts():
    """Alone, where the calibration has none; else the larger of the two."""
    stating = replace(calibration(), color_model=Stating(LIGHTS))
    alone = gelform.Reconstructor(replace(stating, slope_sigma=None))(image_of(TOUCH))
    np.testing.assert_allclose(alone.gradients_sigma[20:40, 40:60], 0.04, rtol=1e-3)
    both = gelform.Reconstructor(stating)(image_of(TOUCH))
    for result in (alone, both):
        assert result.confidence[:, :20].max() < 0.02
        assert np.median(result.confidence[:, 40:]) == 1
    assert both.gradients_sigma[TRUTH > 0.2].min() >= 0.999 * 0.04


def test_depth_sigma_is_at_most_that_of_not_knowing():
    """A depth between 0 and 10 um of which nothing is known has a deviation of 10 um / sqrt(12)."""
    thin = replace(calibration(), settings={"gel_thickness_mm": 0.01})
    sigma = gelform.Reconstructor(thin)(image_of(TOUCH)).depth_sigma_mm
    assert sigma.max() == pytest.approx(0.01 / np.sqrt(12), rel=1e-5)


FRAME = image_of(TOUCH).astype(np.float32)
TILT = np.exp(0.05 * np.linspace(-1, 1, SHAPE[1])[:, None])
# What is changed -> calibration and image, the signs of the axes and the unit of length in them, and two bounds on 99 % of
# the pixels, as fractions of a map's range: of depth and slopes, and of what is stated of them, with the finding it gives.
CHANGES = {
    "left and right": (lambda of: (of((-1, 1)), FRAME[:, ::-1]), (-1, 1), 1, 5e-4, 3e-3, ()),
    "top and bottom": (lambda of: (of((1, -1)), FRAME[::-1]), (1, -1), 1, 5e-4, 3e-3, ()),
    "both": (lambda of: (of((-1, -1)), FRAME[::-1, ::-1]), (-1, -1), 1, 5e-4, 3e-3, ()),
    "gain of image and background": (lambda of: (relit(of(), 0.8), 0.8 * FRAME), (1, 1), 1, 5e-4, 2e-2, ()),
    "levels of image and background": (lambda of: (relit(of(), 1, -10), FRAME - 10), (1, 1), 1, 1e-4, 1e-3, ()),
    "exposure": (lambda of: (of(), 1.08 * FRAME), (1, 1), 1, 5e-4, 2e-2, ("exposure",)),
    "white balance": (lambda of: (of(), FRAME * (0.94, 1, 1.06)), (1, 1), 1, 5e-4, 2e-2, ("exposure",)),
    "tilted light": (lambda of: (of(), FRAME * TILT), (1, 1), 1, 5e-3, 2e-2, ("tilted_light",)),
    "room light": (lambda of: (of(), FRAME + 20), (1, 1), 1, 8e-3, 3e-2, ("room_light",)),
    "mm_per_px": (lambda of: (replace(of(), mm_per_px=0.125, mm_per_px_sigma=1.25e-3), FRAME), (1, 1), 1.25, 1e-3, 2e-2, ()),
}  # fmt: skip


def relit(known, gain, levels=0):
    """Of an untouched gel in another light; an offset makes up for the levels."""
    change = replace(known.change, offset=-float(levels))
    noise = gain * known.background_noise
    return replace(known, background=gain * known.background + levels, background_noise=noise, change=change)


@pytest.mark.parametrize("known", [calibration, stepping])
@pytest.mark.parametrize("change", CHANGES)
def test_every_map_follows_what_is_changed(change, known):
    """Flips, light, levels and scale, with and without a step by the forward response."""
    make, signs, unit, most, most_stated, findings = CHANGES[change]
    changed, image = make(known)
    plain = gelform.Reconstructor(known())(FRAME)
    other = gelform.Reconstructor(changed)(np.ascontiguousarray(image, np.float32))
    assert tuple(one.name for one in other.health) == findings
    for name in (*MAPS, "albedo"):
        here, there = (np.asarray(getattr(result, name), float) for result in (plain, other))
        there = there[:: signs[1], :: signs[0]] / (unit if name.startswith("depth") else 1)
        if name.endswith("gradients") or name == "normals":
            there = there * (*signs, 1)[: here.shape[2]]
        apart = np.abs(here - there) / max(np.ptp(here), 1e-9)
        stated = name in ("depth_sigma_mm", "gradients_sigma", "confidence", "contact", "albedo")
        bound = most_stated if stated else most
        assert (np.mean(apart) if name in ("contact", "known") else np.quantile(apart, 0.99)) <= bound, name
