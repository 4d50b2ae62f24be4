"""What was measured beside the presses, as a sensor.toml holds it and as a report says it."""

import numpy as np

from gelform.calibration.geometry.crosstalk import Crosstalk
from gelform.calibration.geometry.measured import Geometry

MATRIX = [[1, 0.2, 0.05], [0.1, 1, 0.3], [0, 0.2, 1]]


def test_nothing_is_measured_by_default():
    geometry = Geometry()
    assert geometry.matrix is None
    assert geometry.settings() == {}
    scale, crosstalk = geometry.notes(1.0, None)
    assert "the number given. Its standard deviation is not known" in scale
    assert "The color model absorbs the crosstalk" in crosstalk


def test_the_table_of_a_sensor_toml():
    table = {"scale": "a punch of 5 mm", "lens": "96 points", "crosstalk": MATRIX}
    geometry = Geometry.from_settings(table)
    np.testing.assert_array_equal(geometry.matrix, MATRIX)
    assert geometry.crosstalk == Crosstalk(geometry.matrix, ((0.0,) * 3,) * 3)
    assert geometry.settings() == {
        "scale_source": "a punch of 5 mm",
        "lens": "96 points",
        "crosstalk": geometry.crosstalk.describe(),
    }


def test_a_report_says_all_of_it():
    table = {"scale": "a punch of 5 mm", "lens": "96 points", "crosstalk": MATRIX, "crosstalk_spread": MATRIX}
    notes = Geometry.from_settings(table).notes(0.45, 0.0004)
    assert notes[0].startswith("The scale comes from a punch of 5 mm. Its standard deviation is 0.0004 mm/px")
    assert "30.0 % (blue light in the green channel)" in notes[1]
    assert "exponent 0.45" in notes[2]
    assert notes[3] == "gelform corrects the lens: 96 points."
