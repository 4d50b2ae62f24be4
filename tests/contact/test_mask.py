"""Contact of analytic ball presses: where it is known, how noise, specks and the frame's border act on it."""

import numpy as np
import pytest

from gelform.contact import contact_from_depth
from gelform.simulate import LAYOUTS, Ball, simulate_press

PITCH = 0.0634


def cap(shape=(240, 320), *, center=(160, 120), ball_mm=4.0, depth_mm=0.8):
    """A ball's cap over a plane: its rim is where the depth reaches 0; radius in px beside it."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    r = np.hypot(x - center[0], y - center[1]) * PITCH
    z = np.sqrt(np.maximum(ball_mm**2 - r**2, 0)) - (ball_mm - depth_mm)
    return np.maximum(z, 0), r / PITCH, np.sqrt(ball_mm**2 - (ball_mm - depth_mm) ** 2) / PITCH


@pytest.mark.parametrize("noise_mm", [0, 0.003, 0.01])
@pytest.mark.parametrize("center", [(160, 120), (5, 120), (300, 230)])
def test_a_cap_keeps_its_radius_under_noise_and_across_the_border(noise_mm, center):
    depth, r, radius = cap(center=center)
    noise = np.random.default_rng(0).normal(0, noise_mm, depth.shape)
    contact = contact_from_depth(depth + noise, mm_per_px=PITCH)
    assert contact[r < 0.8 * radius].all()
    assert not contact[r > radius + 1].any()


def test_the_rim_is_where_the_rule_says():
    depth, r, radius = cap()
    contact = contact_from_depth(depth, mm_per_px=PITCH)
    assert contact.dtype == bool
    assert np.array_equal(contact, depth > 0.3 * depth.max())
    assert np.isclose(r[contact].max() / radius, 0.84, atol=0.02)
    whole = contact_from_depth(depth, mm_per_px=PITCH, rim_fraction=0)
    assert np.array_equal(whole, depth > 0.02)


def test_a_faint_touch_beside_a_deep_one_is_seen():
    deep, *_ = cap(center=(80, 120))
    faint, r, radius = cap(center=(240, 120), depth_mm=0.06)
    contact = contact_from_depth(deep + faint, mm_per_px=PITCH)
    assert contact[r < 0.7 * radius].all()


def test_specks_go_and_nothing_is_found_on_a_gel_at_rest():
    noise = np.random.default_rng(1).normal(0, 0.02, (240, 320))
    assert not contact_from_depth(noise, mm_per_px=PITCH).any()
    assert not contact_from_depth(np.zeros((24, 32)), mm_per_px=PITCH).any()
    speck = np.zeros((240, 320))
    speck[100:104, 100:104] = 0.5
    assert not contact_from_depth(speck, mm_per_px=PITCH).any()
    assert contact_from_depth(speck, mm_per_px=PITCH, min_area_mm2=0.05).sum() == 16


@pytest.mark.parametrize(("deviations", "seen"), [(3.6, False), (4.4, True)])
def test_what_counts_is_four_deviations_of_the_gel_at_rest(deviations, seen):
    """Read from the gel below zero, also where a press covers a third of the frame."""
    depth = np.random.default_rng(2).normal(0, 0.02, (120, 160))
    depth[:, 100:] = 0.02 * deviations
    contact = contact_from_depth(depth, mm_per_px=PITCH)
    assert contact[:, 100:].all() == contact.any() == seen
    assert contact_from_depth(depth, mm_per_px=PITCH, noise_factor=2.5)[:, 100:].all()


def test_the_least_area_is_in_mm():
    depth, *_ = cap()
    assert np.array_equal(
        contact_from_depth(depth, mm_per_px=PITCH), contact_from_depth(depth, mm_per_px=(PITCH, PITCH))
    )
    small = np.zeros((240, 320))
    small[100:110, 100:110] = 0.5
    assert contact_from_depth(small, mm_per_px=0.04).any()
    assert not contact_from_depth(small, mm_per_px=0.02).any()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_contact_of_a_simulated_press_within_the_stated_range(layout):
    sensor = LAYOUTS[layout]
    press = simulate_press(sensor, Ball(4.0), depth_mm=0.6, rng=None)
    contact = contact_from_depth(press.depth_mm, mm_per_px=sensor.mm_per_px)
    assert 0.98 < np.sqrt(contact.sum() / press.contact.sum()) < 1.2


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"mm_per_px": 0}, "mm_per_px > 0"),
        ({"rim_fraction": 1}, "rim_fraction of 0 to below 1"),
        ({"noise_factor": -1}, "noise_factor >= 0"),
        ({"min_area_mm2": float("nan")}, "min_area_mm2 >= 0"),
        ({"min_depth_mm": 0}, "min_depth_mm > 0"),
    ],
)
def test_wrong_settings(settings, text):
    with pytest.raises(ValueError, match=text):
        contact_from_depth(np.zeros((8, 8)), **{"mm_per_px": PITCH, **settings})


def test_wrong_depth():
    with pytest.raises(ValueError, match="NaN"):
        contact_from_depth(np.full((8, 8), np.nan), mm_per_px=PITCH)
    with pytest.raises(ValueError, match="one frame"):
        contact_from_depth(np.zeros((2, 8, 8)), mm_per_px=PITCH)
