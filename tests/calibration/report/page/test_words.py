"""What the report's page says of settings: rounded, joined, short."""

import pytest

from gelform.calibration.report.page.words import setting_in_words


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (0.8500000000000001, "0.85"),
        (3e-4, "0.0003"),
        ([1.2345678, 0.98765432], "1.235 / 0.9877"),
        ((3, 2, 0), "3 / 2 / 0"),
        ({"exposure": 33.33333333, "led": "on"}, "exposure: 33.33, led: on"),
        ({}, "none"),
        (None, "none"),
        ("0123456789abcdef" * 4, "0123456789ab…"),
        (True, "True"),
        ("three-edges", "three-edges"),
    ],
)
def test_settings_are_said_for_people(value, said):
    assert setting_in_words(value) == said
