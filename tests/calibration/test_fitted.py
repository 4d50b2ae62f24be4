"""The color model and the forward response of all presses, and how large a change an untouched pixel may show."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.candidates import Candidate
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.locate import refine
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.fitted import (
    FIRST_GUESS,
    USUAL_UNTOUCHED_CHANGE,
    _settings,
    fit_all,
    image_noise,
    relaxation_from_presses,
    slopes_around,
    untouched_change,
)
from gelform.simulate import LAYOUTS, Ball
from gelform.simulate.gel.ball_press import ball_press
from gelform.simulate.gel.gel import surface_from_indenter
from gelform.slopes.color_models.forward_response import RIDGES


class Change:
    """A prepared press, as far as its size of change goes."""

    def __init__(self, size):
        self.size = size


def circle(x, y, radius):
    fields = dict.fromkeys(ContactCircle.__dataclass_fields__, 0.0)
    return ContactCircle(**{**fields, "x_px": x, "y_px": y, "radius_px": radius})


def test_it_is_seen_beyond_three_radii():
    size = np.full((60, 80), 9.0, dtype=np.float32)
    rows, columns = np.mgrid[:60, :80]
    size[np.hypot(columns - 20, rows - 30) > 30] = 0.01
    assert untouched_change([Change(size)], [circle(20, 30, 10)]) == pytest.approx(0.01)
    assert untouched_change([Change(size)], [circle(20, 30, 9)]) > 1, (
        "a ring of touched gel is inside three radii"
    )


def test_a_press_as_large_as_the_image_leaves_the_usual():
    size = np.ones((20, 30), dtype=np.float32)
    assert untouched_change([Change(size)], [circle(15, 10, 30)]) == USUAL_UNTOUCHED_CHANGE


def test_the_draft_is_of_the_accepted_presses(presses, calibration):
    digests = [
        press.digest for press, row in zip(presses.presses, calibration.report.presses) if row.accepted
    ]
    assert list(calibration.training_digests) == digests
    assert calibration.settings["presses"] == len(digests)


def test_the_cameras_settings_are_kept(presses, calibration):
    assert "camera" not in calibration.settings
    candidate = Candidate("hierarchical", (("ridge", 1e-3),), step_ridge=3e-5)
    with_camera = replace(presses, camera={"exposure": 50.0})
    images = [press.image for press in presses.presses]
    kept = _settings(with_camera, candidate, images, 0.8, relaxation_mm=0.5)
    assert kept["camera"] == {"exposure": 50.0}
    assert kept["relaxation_mm"] == 0.5
    assert (kept["contact_radius_ratio"], kept["ridge"], kept["step_ridge"]) == (0.8, 1e-3, 3e-5)
    assert "step_ridge" not in _settings(with_camera, replace(candidate, step_ridge=None), images, 0.8)


def test_the_noise_of_images_is_found_under_what_is_smooth():
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:120, :160] / 20
    background = (100 + 10 * np.sin(x) + 5 * np.cos(y))[..., None] * np.ones(3)
    images = [
        background + (20 * np.sin(x + k))[..., None] + rng.normal(size=(120, 160, 3)) * [1, 2, 3]
        for k in range(15)
    ]
    np.testing.assert_allclose(image_noise(images, background.astype(np.float32)), [1, 2, 3], rtol=0.03)


@pytest.fixture(scope="module")
def drafted(presses, prepared, found):
    """Makes the draft of the presses, some of their images changed, by a candidate of a given step."""
    refined = refine(prepared, found)

    def make(step_ridge, change=lambda image: image):
        candidate = Candidate("polynomial", (("position_degrees", (2, 1)),), step_ridge=step_ridge)
        changed = tuple(replace(press, image=change(press.image)) for press in presses.presses)
        own = replace(presses, presses=changed).subset(refined.accepted)
        return fit_all(own, *refined.of_accepted(prepared), candidate, 0.02)

    return make


def test_a_step_is_in_the_draft_where_one_was_chosen(drafted):
    """The forward response is there all the same: it renders, and says what a fault is."""
    plain, stepped = drafted(None), drafted(RIDGES[0])
    assert plain.forward.step_sigma is None
    at_rest, per_slope = stepped.forward.step_sigma
    assert 0.001 < at_rest < per_slope < 0.5
    np.testing.assert_array_equal(plain.forward.nodes, stepped.forward.nodes)
    assert plain.slope_sigma == FIRST_GUESS
    assert stepped.slope_sigma.per_step == 1.0, "what the step states, as it states it"


def test_channels_that_presses_clip_are_kept(drafted, prepared, found):
    """At each end, by the share of the pixels that train: what is learned there holds for clipped pixels too."""
    inside = prepared[0].pixels(found[0], 0.9)

    def clipped(image):
        changed = np.clip(image, 10, 245)  # all usual levels lie between
        changed[inside[0], inside[1], 2] = 255
        changed[inside[0][:3], inside[1][:3], 0] = 0  # of hardly any pixel
        return changed

    usual = drafted(RIDGES[0], lambda image: np.clip(image, 10, 245)).forward.clipped
    assert usual.shape == (2, 3)
    assert not usual.any()
    np.testing.assert_array_equal(
        drafted(RIDGES[0], clipped).forward.clipped, [[False, False, False], [False, False, True]]
    )


PITCH = 0.0634
REST = np.zeros((240, 320, 3), np.float32)


class SlopesAsColors:
    """A color model whose color changes are the slopes themselves."""

    def prepare(self, background, shape):
        return self

    def gradients_from_color(self, change):
        return change[..., :2], None


def presses(length, noise=0.02, tilt=0.0, centers=((0, 0), (-2, 1), (3, -2))):
    x_mm, y_mm = LAYOUTS["three-edges"].grid_mm()
    rng, made, circles = np.random.default_rng(0), [], []
    for center, radius, depth in zip(centers, (2.5, 4.0, 2.5), (0.3, 0.4, 0.5)):
        surface = surface_from_indenter(
            Ball(radius), x_mm, y_mm, center_mm=center, depth_mm=depth, relaxation_mm=length
        )
        change = rng.normal(tilt, noise, REST.shape).astype(np.float32)
        change[..., :2] += surface.gradients
        made.append(PreparedPress("a", change, np.zeros(REST.shape[:2], np.float32), radius / PITCH))
        contact_px = ball_press(radius, depth, length).contact_radius_mm / PITCH
        middle = (center[0] / PITCH + 159.5, center[1] / PITCH + 119.5)
        circles.append(ContactCircle(*middle, contact_px, 0.9, 5.0))
    return made, circles


@pytest.mark.parametrize("length", [0.3, 0.5, 0.9])
@pytest.mark.parametrize("tilt", [0.0, 0.05])
def test_the_length_of_simulated_gels(length, tilt):
    made, circles = presses(length, tilt=tilt)
    assert relaxation_from_presses(SlopesAsColors(), made, circles, REST, PITCH) == pytest.approx(
        length, rel=0.06
    )


def test_nothing_is_said_of_noise_or_of_contacts_that_are_cut():
    rng = np.random.default_rng(0)
    made, circles = presses(0.5)
    for one in made:
        one.color_change[:] = rng.normal(0, 0.02, REST.shape)
    assert relaxation_from_presses(SlopesAsColors(), made, circles, REST, PITCH) is None
    made, circles = presses(0.5, centers=((-10, 0), (10, 1), (0, 7.5)))
    assert relaxation_from_presses(SlopesAsColors(), made, circles, REST, PITCH) is None


def test_rings_hold_the_outward_slope_and_leave_out_what_is_not_usable():
    y, x = np.mgrid[:240, :320].astype(np.float32)
    gradients = np.stack([0.1 * (x - 160), 0.1 * (y - 120)], axis=-1)
    usable = (x + y) % 9 > 0
    r_mm, slope, pixels = slopes_around(gradients, ContactCircle(160, 120, 20, 0.9, 5.0), usable, PITCH)
    np.testing.assert_allclose(slope, 0.1 * r_mm / PITCH, rtol=1e-4)
    assert r_mm[0] > 24 * PITCH
    assert pixels.sum() == pytest.approx(8 / 9 * np.pi * ((r_mm[-1] / PITCH) ** 2 - 25**2), rel=0.03)
