"""Whether presses of a sensor cast shadows."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.background.change import ChangeSettings
from gelform.calibration import shadows
from gelform.calibration.circles.find import ContactCircle, magnitude
from gelform.calibration.circles.prepare import ColorChanges
from gelform.calibration.circles.samples import PreparedPress, contact_samples, with_rest_samples
from gelform.calibration.forward import forward_from_presses
from gelform.calibration.shadows import LEAST_NOISE, LEAST_PRESSES, directed_darkness, shadow_noise
from gelform.color_models import PolynomialModel
from gelform.color_models._shared.forward import ForwardResponse
from gelform.color_models._shared.least_squares import term_count
from gelform.simulate import simulate_ball_presses
from gelform.simulate.presets import digit


@pytest.mark.parametrize("casts", [True, False])
def test_a_digit_with_and_without_shadows(casts):
    sensor = replace(digit(), shape=(160, 120), mm_per_px=0.10214, blur_px=0.8, cast_shadows=casts)
    made = simulate_ball_presses(
        sensor, ball_diameters_mm=[4.7], count=LEAST_PRESSES, rng=np.random.default_rng(1), oversample=1
    )
    background = made.background.astype(np.float32)
    changes = ColorChanges(background, ChangeSettings(blur_px=0.8))
    presses, contacts = [], []
    for k, one in enumerate(made.presses):
        change = changes(one.image)[0]
        radius_px = 2.35 / sensor.mm_per_px
        presses.append(PreparedPress(str(k), change, magnitude(change), radius_px, None, background))
        contacts.append(ContactCircle(*one.center_px, 1.2 * one.contact_radius_px, 0.9, 5.0))
    samples = with_rest_samples(contact_samples(presses, contacts, 0.8), presses, contacts)
    model = PolynomialModel.fit(samples, position_degrees=(2, 1))
    forward = forward_from_presses(presses, contacts, 0.8, sensor.mm_per_px, "digit")
    found = shadow_noise(model, forward, presses, contacts, background)
    if casts:
        assert found is not None
        assert LEAST_NOISE <= found < 0.1
        assert shadow_noise(model, forward, presses[1:], contacts[1:], background) is None  # too few to tell
    else:
        assert found is None


def rings(centers, darkness):
    """Darkness (N, 40, 60), distance in radii and direction around contacts with a radius of 7 blocks."""
    y, x = np.mgrid[:40, :60]
    away = np.stack([np.hypot(x - u, y - v) / 7 for u, v in centers])
    turn = np.stack([np.arctan2(y - v, x - u) % (2 * np.pi) for u, v in centers])
    return darkness(away, turn), away, turn


CENTERS = np.random.default_rng(5).uniform((14, 14), (46, 26), (12, 2))
SIDES = np.random.default_rng(6).uniform(0, 2 * np.pi, (12, 1, 1))


def test_shadows_fall_to_the_same_side_of_all_presses():
    to_the_left = directed_darkness(*rings(CENTERS, lambda away, turn: 0.1 * (np.cos(turn - np.pi) > 0.7)))
    assert len(to_the_left) == len(CENTERS)
    assert to_the_left.min() > 0.03
    alike_all_around = directed_darkness(*rings(CENTERS, lambda away, turn: 0.1 * np.exp(-(away**2))))
    np.testing.assert_allclose(alike_all_around, 0, atol=0.005)
    anywhere = directed_darkness(*rings(CENTERS, lambda away, turn: 0.1 * (np.cos(turn - SIDES) > 0.7)))
    assert np.percentile(anywhere, 25) < 0
    opposite = np.array([0, np.pi])[:, None, None]  # a press is held against the others, without itself
    assert (
        directed_darkness(*rings(CENTERS[:2], lambda away, turn: 0.1 * np.cos(turn - opposite))).max() < -0.05
    )


def test_darkness_of_a_pattern_is_its_deviation_over_the_sectors():
    found = directed_darkness(*rings(CENTERS, lambda away, turn: 0.2 + 0.1 * np.cos(turn)))
    np.testing.assert_allclose(found, 0.1 / np.sqrt(2), rtol=0.03)


def test_presses_cut_by_the_border_count_by_what_is_seen():
    cut = np.vstack([CENTERS, [(0, 20), (-30, -30)]])  # half a ring, and none of it
    found = directed_darkness(*rings(cut, lambda away, turn: 0.1 * np.sin(2 * turn)))
    assert len(found) == len(CENTERS) + 1
    np.testing.assert_allclose(found, 0.1 / np.sqrt(2), rtol=0.1)


def ring_of(darkness):
    """What `shadow_noise` looks at, of presses that are dark enough around their contacts."""
    return rings(CENTERS, lambda away, turn: darkness(turn) * ((away > 1) & (away < 1.8)))


@pytest.mark.parametrize(
    ("darkness", "casts"),
    [(lambda turn: 0.2 * (np.cos(turn - 1) > 0.5), True), (lambda turn: 0.2 + 0 * turn, False)],
)
def test_dark_rings_are_no_shadows(monkeypatch, darkness, casts):
    """A model that reads all rims badly leaves much darkness; it is directed nowhere."""
    dark, away, turn = ring_of(darkness)
    dark = dark.astype(np.float32)
    monkeypatch.setattr(shadows, "_around_contacts", lambda *_: (dark, away, turn))
    forward = flat_response((160, 240))
    press = PreparedPress("", np.zeros((160, 240, 3), np.float32), np.zeros((160, 240), np.float32), 60.0)
    found = shadow_noise(None, forward, [press] * len(CENTERS), [None] * len(CENTERS), None)
    assert found == (LEAST_NOISE if casts else None)


def flat_response(shape):
    """A forward response in which every slope changes the channels alike everywhere."""
    coefficients = np.zeros((term_count(2, (0, 0, 0)), 3))
    coefficients[:2] = [[1, -0.5, -0.5], [0, 0.9, -0.9]]
    return ForwardResponse(coefficients, (0, 0, 0), shape, np.full(3, 0.01))
