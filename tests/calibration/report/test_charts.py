"""Charts: a point lies where its value says, every text is escaped, each SVG is well formed."""

import xml.etree.ElementTree as ElementTree

import pytest

from gelform.calibration.report.charts import Axes, bar_of, scale_of_errors
from gelform.calibration.report.page import templates

CHARTS = templates().get_template("charts.html").module
SHAPE = (60, 80)


def test_axes_run_right_and_up_and_a_band_stays_in_the_plot():
    axes = Axes((0, 10), (0, 1), (), ())
    assert axes.x(0) < axes.x(5) < axes.x(10)
    assert axes.y(0) > axes.y(0.5) > axes.y(1)
    assert axes.x(5) - axes.x(0) == pytest.approx(axes.x(10) - axes.x(5))
    ys = [float(pair.split(",")[1]) for pair in axes.band((0, 10), (-5, -5), (9, 9)).split()]
    assert (min(ys), max(ys)) == pytest.approx((axes.y(1), axes.y(0)), abs=0.1)


def elements(drawn, tag, kind):
    return [e for e in ElementTree.fromstring(drawn.strip()).iter(tag) if e.get("class") == kind]


def circles(drawn, kind):
    return [(float(c.get("cx")), float(c.get("cy"))) for c in elements(drawn, "circle", kind)]


def bins_of(name, values):
    """Bins of slopes a tenth wide, with a figure each."""
    return [
        {"slope_from": 0.1 * k, "slope_to": 0.1 * k + 0.1, name: value, "interval": [0.5, 1.3]}
        for k, value in enumerate(values)
    ]


def test_a_gain_below_one_is_drawn_below_the_line():
    bins, beyond = bins_of("gain", (1.1, 1.0, 0.9)), bins_of("gain", (0.8, 0.7, 0.6))
    dots = circles(CHARTS.gain_chart({"contact": bins, "rim": []}), "dot-first")
    assert [x for x, _ in dots] == sorted(x for x, _ in dots)
    assert dots[0][1] < dots[1][1] < dots[2][1]
    assert not CHARTS.gain_chart({"contact": [], "rim": []}).strip()
    both = CHARTS.gain_chart({"contact": bins, "rim": beyond})
    assert circles(both, "dot-first") == dots, "one gain: of the contact"
    assert circles(both, "dot-second") == []


def test_the_learning_chart_has_every_draw_and_what_is_expected(learning):
    drawn = CHARTS.learning_chart({**learning, "sentence": '<script>"&'})
    assert "<script>" not in drawn
    assert elements(drawn, "svg", "chart")[0][0].text == 'Learning curve: <script>"&'
    assert len(circles(drawn, "draw")) == sum(len(p["draws_deg"]) for p in learning["points"])
    (now, _), (later, _) = circles(drawn, "expected")
    assert now < later
    assert f"now: {learning['expected']['presses_now']}" in drawn


def test_shares_far_off_stand_out():
    root = ElementTree.fromstring(
        CHARTS.sigma_chart({"by_slope": bins_of("share", (0.68, 0.5, 0.2))}).strip()
    )
    assert [rect.get("class") for rect in root.iter("rect")] == ["bar", "bar off", "bar far"]
    assert not CHARTS.sigma_chart({"by_slope": []}).strip()


def test_a_share_has_the_color_of_the_percents_that_are_printed():
    for percent, kind in [
        (59.4, "bar off"),
        (59.6, "bar"),
        (60, "bar"),
        (76.4, "bar"),
        (76.6, "bar off"),
        (44.4, "bar far"),
    ]:
        assert bar_of(percent) == kind


def test_markers_lie_between_their_limits():
    (x, _), *_ = circles(CHARTS.limit_bar(2.0, [1.5, 2.5], 3, 5), "marker")
    (good,) = elements(CHARTS.limit_bar(2.0, [1.5, 2.5], 3, 5), "rect", "zone-good")
    assert 0 < x < float(good.get("width"))
    (far, _), *_ = circles(CHARTS.limit_bar(50.0, None, 3, 5), "marker")
    assert far <= 200


def test_ranges_share_a_scale():
    one, two = (
        circles(CHARTS.range_bar({"normal_free_deg": v, "chosen": False}, 5), "dot-first")[0][0]
        for v in (2.0, 4.0)
    )
    assert two == pytest.approx(2 * one)


def coverage(counts):
    place = {"x_px": 59.5, "y_px": 14.5, "contact_radius_px": 10.0}
    return {"rows": 1, "columns": 2, "presses": counts, "next": [place]}


def test_a_petal_is_empty_where_no_press_was():
    drawn = CHARTS.coverage_map(coverage([[0, 1, 2, 3, 9, 0, 0, 0], [1] * 8]), SHAPE)
    petals = elements(drawn, "path", "petal")
    assert len(petals) == 12
    assert len(elements(drawn, "path", "petal none")) == 4
    opacities = [float(p.get("fill-opacity")) for p in petals[:4]]
    assert opacities[0] < opacities[1] < opacities[2] == opacities[3]


def test_the_next_press_is_drawn_at_its_place_and_octant_zero_points_to_the_right():
    drawn = CHARTS.coverage_map(coverage([[1] * 8] * 2), SHAPE)
    mark, scale = elements(drawn, "circle", "next")[0], 560 / 80
    place = [float(mark.get(name)) for name in ("cx", "cy", "r")]
    assert place == pytest.approx([60 * scale, 15 * scale, 10 * scale], abs=0.1)
    first = elements(drawn, "path", "petal")[0].get("d")
    start, line = (float(first.split(letter)[1].split()[0]) for letter in "ML")
    assert line > start


def test_arrows_point_along_the_error_and_empty_cells_stay_blank():
    errors = {
        "rows": 2,
        "columns": 2,
        "rms": [0.1, 0.2, None, 0.05],
        "mean": [[0.1, 0], [0, 0.2], None, [0, 0]],
    }
    drawn = CHARTS.slope_error_map(errors, SHAPE)
    assert len(elements(drawn, "rect", "heat")) == 3
    right, down, still = elements(drawn, "line", "arrow")
    assert float(right.get("x2")) > float(right.get("x1"))
    assert right.get("y2") == right.get("y1")
    assert float(down.get("y2")) > float(down.get("y1"))
    assert still.get("x2") == still.get("x1")
    assert scale_of_errors({"rms": [None]}) == 1.0


def test_shares_are_written_into_their_cells():
    sigma = {"rows": 1, "columns": 3, "by_place": [0.68, None, 0.3]}
    texts = [e.text for e in elements(CHARTS.share_map(sigma, SHAPE), "text", "cell")]
    assert texts == ["68 %", "–", "30 %"]
