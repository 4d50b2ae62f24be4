"""Whether presses of a sensor cast shadows."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.background.change import ChangeSettings
from gelform.calibration.circles.find import ContactCircle, magnitude
from gelform.calibration.circles.prepare import ColorChanges
from gelform.calibration.circles.samples import PreparedPress, contact_samples, with_rest_samples
from gelform.calibration.forward import forward_from_presses
from gelform.calibration.shadows import LEAST_NOISE, LEAST_PRESSES, shadow_noise
from gelform.color_models import PolynomialModel
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
