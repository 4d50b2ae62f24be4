"""Sections: they say the figures, mark the chosen model, and render whatever a candidate was measured by."""

import re

import pytest

from gelform.calibration.report.page.sections import (
    coverage_section,
    digits,
    figures_section,
    learning_section,
    models_section,
    place_in_words,
    setting_in_words,
    where_section,
)


def test_figures_stand_with_their_intervals_and_one_that_does_not_exist_is_a_dash(content):
    assert [digits(v) for v in (2.0, 19.0, 0.5, 123.4)] == ["2.00", "19.0", "0.500", "123"]
    drawn = figures_section(content)
    one = content["figures"]["normal_free_deg"]
    value, low, high = (digits(v) for v in (one["value"], *one["interval"]))
    assert f"<b>{value}° <small>{low} – {high}" in drawn
    assert drawn.count("<tr>") == len(content["checks"]) + 1
    figures = {name: one for name, one in content["figures"].items() if name != "off_contact_um"}
    assert "no press leaves enough of the image free" in figures_section({**content, "figures": figures})


def test_every_figure_of_a_candidate_is_rendered():
    rows = [
        {"candidate": "b step 3e-05", "slope_error": 0.0213, "normal_free_deg": 1.5, "chosen": True}
        | {"new_figure": 7.0, "new_figure_se": 0.5, "other": float("nan")},
        {"candidate": "a <1>", "slope_error": 0.0345, "normal_free_deg": 2.0, "chosen": False},
    ]
    drawn = models_section({"candidates": rows})
    assert "a &lt;1&gt;" in drawn
    for text in (
        "typical slope error",
        "0.0213",
        "0.0345",
        "7 ± 0.5",
        "new figure",
        "smallest typical slope error",
    ):
        assert text in drawn
    assert re.search(r'<tr class="chosen"><td>b step 3e-05 ← chosen', drawn)
    assert "Only one model was tried" in models_section({"candidates": rows[:1]})
    assert "decides" not in models_section({"candidates": rows[:1]})


def test_places_to_press_are_said_in_words_in_their_order(content):
    place = {"name": "top left", "x_px": 10, "y_px": 20}
    assert place_in_words(place, 0.1) == "top left: (10, 20) px, 1.0 mm from the left, 2.0 mm from the top"
    drawn = coverage_section(content)
    assert drawn.count("<li>") >= 3
    assert place_in_words(content["coverage"]["next"][0], content["calibration"]["mm_per_px"]) in drawn


def test_the_learning_sentence_is_there_or_why_not(content):
    assert content["learning"]["sentence"] in learning_section(content)
    assert "There is no learning curve" in learning_section({**content, "learning": None})


WHERE = {
    "contact_radius_ratio": 0.84,
    "contact": {
        "normal_deg": 2.12,
        "by_slope": [
            {"slope_from": 0.1, "slope_to": 0.2, "normal_deg": 1.11, "gain": 1.02, "pixels": 500},
            {"slope_from": 0.7, "slope_to": 0.8, "normal_deg": 4.44, "gain": 0.91, "pixels": 90},
        ],
        "by_place": {"rows": 2, "columns": 2, "normal_deg": [1.0, 2.0, None, 3.0], "pixels": [99, 99, 0, 99]},
    },
    "rim": {
        "normal_deg": 3.36,
        "by_slope": [{"slope_from": 0.1, "slope_to": 0.2, "normal_deg": 1.99, "gain": 1.01, "pixels": 600}],
        "by_place": {"rows": 2, "columns": 2, "normal_deg": [1.5, 2.6, 7.0, None], "pixels": [99, 99, 70, 5]},
    },
}


def test_slopes_and_places_stand_in_their_rows_and_a_missing_bin_is_a_dash():
    page = where_section({"where": WHERE})
    for said in (
        "2.12° inside the contact edge, at 0.84 of the visible radius, and 3.36° up to 3 px inside",
        "<td>0.1 – 0.2</td><td>1.11°</td><td>1.99°</td><td>1.02</td><td>500</td>",
        "<td>0.7 – 0.8</td><td>4.44°</td><td>–</td><td>0.91</td><td>90</td>",
        "<tr><td>1.00°\u00a0/\u00a01.50°</td><td>2.00°\u00a0/\u00a02.60°</td></tr><tr><td>–\u00a0/\u00a07.00°</td><td>3.00°\u00a0/\u00a0–</td></tr>",
    ):
        assert said in page


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
        ("0123456789abcdef" * 4, "0123456789…"),
        (True, "True"),
        ("three-edges", "three-edges"),
    ],
)
def test_settings_are_said_for_people(value, said):
    assert setting_in_words(value) == said
