"""Crosstalk comes back from frames with one LED lit, and undone images are those of a sensor without it.

What was measured beside the presses, as a sensor.toml holds it and as a report says it.
"""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.geometry.measured import Crosstalk, Geometry, crosstalk_from_frames
from gelform.errors import DataError
from gelform.image.background import ChangeSettings, color_change_from_image
from gelform.simulate import LAYOUTS, Ball, Optics, simulate_background, simulate_press
from gelform.simulate.sensor import IDENTITY

MIXING = ((1.0, 0.15, 0.02), (0.1, 1.0, 0.2), (0.0, 0.12, 1.0))
PURE = replace(LAYOUTS["three-edges"], shape=(120, 160), mm_per_px=0.1268, ambient=(0, 0, 0))


BALANCE = np.array(PURE.white_balance)
SEEN = np.array(MIXING) * BALANCE[:, None] / BALANCE  # a gain behind the filters is part of what is seen


def pure_leds(sensor):
    """Each LED in its own channel alone."""
    strongest = [int(np.argmax(led.color)) for led in sensor.leds]
    leds = [
        replace(led, color=tuple(float(max(led.color)) if c == k else 0.0 for c in range(3)))
        for led, k in zip(sensor.leds, strongest)
    ]
    return replace(sensor, leds=tuple(leds)), strongest


def led_frames(sensor, rng=None, quantise=True):
    pure, strongest = pure_leds(sensor)
    frames = []
    for k in range(3):
        lit = tuple(led for led, color in zip(pure.leds, strongest) if color == k)
        frames.append(np.clip(simulate_background(replace(pure, leds=lit), rng, quantise=quantise), 0, 255))
    return frames


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_the_matrix_comes_back(gamma):
    sensor = replace(PURE, crosstalk=MIXING, optics=Optics(response_gamma=gamma))
    found = crosstalk_from_frames(led_frames(sensor, quantise=False), response=1 / gamma)
    np.testing.assert_allclose(found.matrix, SEEN, atol=1e-4)
    assert np.max(found.spread) < 1e-4
    noisy = crosstalk_from_frames(led_frames(sensor, np.random.default_rng(0)), response=1 / gamma)
    np.testing.assert_allclose(noisy.matrix, SEEN, atol=0.01)
    assert "17." in noisy.describe()
    assert "blue light in the green channel" in noisy.describe()


def test_undone_changes_are_those_without_crosstalk():
    clean = replace(pure_leds(PURE)[0], crosstalk=IDENTITY)
    mixed = replace(clean, crosstalk=MIXING)
    how = {"rng": None, "quantise": False, "oversample": 1, "depth_mm": 0.6}
    rests = [np.clip(simulate_background(one, None, quantise=False), 0, 255) for one in (clean, mixed)]
    images = [np.clip(simulate_press(one, Ball(3.0), **how).image, 0, 255) for one in (clean, mixed)]
    assert np.max(images) < 255, "unsaturated"
    matrix = crosstalk_from_frames(led_frames(mixed, quantise=False)).matrix
    wanted = color_change_from_image(images[0], rests[0], ChangeSettings())
    as_it_is = color_change_from_image(images[1], rests[1], ChangeSettings())
    undone = color_change_from_image(images[1], rests[1], ChangeSettings(crosstalk=matrix))
    assert np.abs(as_it_is - wanted).max() > 0.05
    np.testing.assert_allclose(undone, wanted, atol=1e-3)


def test_ambient_light_is_taken_off_with_a_dark_frame():
    sensor = replace(PURE, crosstalk=MIXING, ambient=(0.0002, 0.0002, 0.0002))
    faint = (replace(PURE.leds[0], color=(1e-12, 1e-12, 1e-12)),)
    dark = np.clip(simulate_background(replace(sensor, leds=faint), None, quantise=False), 0, 255)
    found = crosstalk_from_frames(led_frames(sensor, quantise=False), dark=dark)
    np.testing.assert_allclose(found.matrix, SEEN, atol=1e-3)


def test_position_dependence_is_reported():
    frames = [frame.astype(np.float32) for frame in led_frames(replace(PURE, crosstalk=MIXING))]
    frames[0][..., 1] += np.linspace(0, 0.2, 160)[None] * frames[0][..., 0]
    found = crosstalk_from_frames(np.clip(frames, 0, 255))
    assert found.spread[1][0] > 0.03
    assert found.spread[2][0] < 0.02


def test_wrong_frames_are_refused():
    frames = led_frames(replace(PURE, crosstalk=MIXING))
    with pytest.raises(
        DataError, match=r"red LED's frame brightest in red, got red .*order red, green, blue"
    ):
        crosstalk_from_frames([frames[1], frames[0], frames[2]])
    with pytest.raises(DataError, match="levels of 20-250"):
        crosstalk_from_frames([frames[0] // 20, frames[1], frames[2]])
    with pytest.raises(ValueError, match="three frames"):
        crosstalk_from_frames(frames[:2])


MATRIX = [[1, 0.2, 0.05], [0.1, 1, 0.3], [0, 0.2, 1]]


def test_nothing_is_measured_by_default():
    geometry = Geometry()
    assert geometry.matrix is None
    assert geometry.settings() == {}
    scale, crosstalk = geometry.notes(1.0, None)
    assert "the number given. Its standard deviation is not known" in scale
    assert "The color model absorbs the crosstalk" in crosstalk


def test_the_table_of_a_sensor_toml_and_what_a_report_says_of_it():
    table = {"scale": "a punch of 5 mm", "lens": "96 points", "crosstalk": MATRIX}
    geometry = Geometry.from_settings(table)
    np.testing.assert_array_equal(geometry.matrix, MATRIX)
    assert geometry.crosstalk == Crosstalk(geometry.matrix, ((0.0,) * 3,) * 3)
    assert geometry.settings() == {
        "scale_source": "a punch of 5 mm",
        "lens": "96 points",
        "crosstalk": geometry.crosstalk.describe(),
    }
    notes = Geometry.from_settings({**table, "crosstalk_spread": MATRIX}).notes(0.45, 0.0004)
    assert notes[0].startswith("The scale comes from a punch of 5 mm. Its standard deviation is 0.0004 mm/px")
    assert "30.0 % (blue light in the green channel)" in notes[1]
    assert "exponent 0.45" in notes[2]
    assert notes[3] == "gelform corrects the lens: 96 points."
