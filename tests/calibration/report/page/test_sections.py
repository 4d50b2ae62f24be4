"""Sections: they say the figures, mark the chosen model, and render whatever a candidate was measured by."""

import re

from gelform.calibration.report.page.sections import (
    coverage_section,
    figures_section,
    learning_section,
    models_section,
)
from gelform.calibration.report.page.words import digits, place_in_words


def test_digits_keep_their_zeros():
    assert [digits(v) for v in (2.0, 19.0, 0.5, 123.4)] == ["2.00", "19.0", "0.500", "123"]


def test_figures_stand_with_their_intervals(content):
    drawn = figures_section(content)
    one = content["figures"]["normal_free_deg"]
    assert (
        f"<b>{digits(one['value'])}° <small>{digits(one['interval'][0])} – {digits(one['interval'][1])}"
        in drawn
    )
    assert drawn.count("<tr>") == len(content["checks"]) + 1


def test_a_figure_that_does_not_exist_is_a_dash(content):
    figures = {name: one for name, one in content["figures"].items() if name != "off_contact_um"}
    assert "no press leaves room for it" in figures_section({**content, "figures": figures})


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
    assert "Only one was tried" in models_section({"candidates": rows[:1]})
    assert "decides" not in models_section({"candidates": rows[:1]})


def test_places_are_said_in_words():
    place = {"name": "top left", "x_px": 10, "y_px": 20}
    assert place_in_words(place, 0.1) == "top left: (10, 20) px, 1.0 mm from the left, 2.0 mm from the top"


def test_places_to_press_are_listed_in_order(content):
    drawn = coverage_section(content)
    assert drawn.count("<li>") >= 3
    assert place_in_words(content["coverage"]["next"][0], content["calibration"]["mm_per_px"]) in drawn


def test_the_learning_sentence_is_there_or_why_not(content):
    assert content["learning"]["sentence"] in learning_section(content)
    assert "There is no learning curve" in learning_section({**content, "learning": None})
