"""A simulated sensor from settings and from TOML."""

import numpy as np
import pytest

from gelform.errors import SensorError
from gelform.sensors.profiles import SENSORS
from gelform.sensors.simulated.settings import (
    read_simulated_sensor,
    sensor_from_settings,
    simulated_sensor_named,
)
from gelform.simulate import simulate_background

TOML = """
base = "gelsight-mini"
name = "mine"
noise_sd = 0.5
exposed_levels = [90, 95, 100]

[[leds]]
position_mm = [-15, 0, 8]
color = [900, 20, 0]

[[leds]]
position_mm = [15, 0, 8]
peak_nm = 525
power = 800
beam_power = 1

[[leds]]
position_mm = [0, 15, 8]
peak_nm = 465
power = 800

[gel]
thickness_mm = 2.5
bulge = 0.6

[coating]
marker_pitch_mm = 2.0
"""


def test_a_toml_file_starts_from_a_base_and_changes_it(tmp_path):
    path = tmp_path / "sensor.toml"
    path.write_text(TOML)
    sensor = read_simulated_sensor(path)
    assert (sensor.name, sensor.noise_sd, sensor.gel.bulge) == ("mine", 0.5, 0.6)
    assert len(sensor.leds) == 3
    assert sensor.leds[1].beam_power == 1
    assert np.argmax(sensor.leds[2].color) == 2
    assert sensor.coating.marker_pitch_mm == 2.0
    assert sensor.coating.seed == SENSORS["gelsight-mini"].simulated().coating.seed
    means = simulate_background(sensor, None, quantise=False).mean((0, 1))
    np.testing.assert_allclose(means, (90, 95, 100), rtol=0.03)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("noise_sd", "noise_ds"), "Did you mean 'noise_sd'"),
        (("bulge", "buldge"), r"\[gel\]. Did you mean 'bulge'"),
        (("beam_power", "beam_powr"), r"\[\[leds\]\]. Did you mean 'beam_power'"),
        (("marker_pitch_mm", "marker_pich_mm"), "Did you mean 'marker_pitch_mm'"),
        (('"gelsight-mini"', '"gelsigt-mini"'), "Did you mean 'gelsight-mini'"),
        (("[-15, 0, 8]", "[1, 0, 1]"), "outside the gel"),
        (("[-15, 0, 8]", "[1, 0, -1]"), "camera's side"),
        (("noise_sd = 0.5", "noise_gain = -0.5"), "noise_gain >= 0"),
        (("noise_sd = 0.5", 'noise_sd = "low"'), "noise_sd"),
        (("[gel]", "gel = 3\n[other]"), "gel"),
        (("[[leds]]", "[[leds]"), "no TOML"),
        (("peak_nm = 525", "peak_nm = 52"), "peak_nm in 380-750"),
    ],
)
def test_bad_toml_is_refused_with_the_reason(tmp_path, change, message):
    path = tmp_path / "sensor.toml"
    path.write_text(TOML.replace(*change, 1))
    with pytest.raises(SensorError, match=message):
        read_simulated_sensor(path)


def test_without_a_base_leds_are_needed(tmp_path):
    with pytest.raises(SensorError, match="No file"):
        read_simulated_sensor(tmp_path / "none.toml")
    with pytest.raises(ValueError, match="got neither"):
        sensor_from_settings({"name": "dark"})
    with pytest.raises(ValueError, match="Did you mean 'digit'"):
        simulated_sensor_named("digitt")
