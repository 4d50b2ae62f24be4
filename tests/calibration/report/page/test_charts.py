"""Charts: a point lies where its value says, every text is escaped, each SVG is well formed."""

import xml.etree.ElementTree as ElementTree

import pytest

from gelform.calibration.report.page.charts import (
    Axes,
    gain_chart,
    learning_chart,
    limit_bar,
    range_bar,
    sigma_chart,
    svg,
)


def test_axes_run_right_and_up():
    axes = Axes((0, 10), (0, 1))
    assert axes.x(0) < axes.x(5) < axes.x(10)
    assert axes.y(0) > axes.y(0.5) > axes.y(1)
    assert axes.x(5) - axes.x(0) == pytest.approx(axes.x(10) - axes.x(5))


def test_a_band_stays_in_the_plot():
    axes = Axes((0, 1), (0, 1))
    drawn = axes.band((0, 1), (-5, -5), (9, 9), "x")
    ys = [float(pair.split(",")[1]) for pair in drawn.split('points="')[1].split('"')[0].split()]
    assert min(ys) == pytest.approx(axes.y(1), abs=0.1)
    assert max(ys) == pytest.approx(axes.y(0), abs=0.1)


def test_titles_are_escaped():
    drawn = svg("", 1, 1, '<script>"&')
    assert "<script>" not in drawn
    assert ElementTree.fromstring(drawn)[0].text == '<script>"&'


def circles(drawn, kind):
    root = ElementTree.fromstring(drawn)
    return [(float(c.get("cx")), float(c.get("cy"))) for c in root.iter("circle") if c.get("class") == kind]


def test_a_gain_below_one_is_drawn_below_the_line():
    bins = [
        {"slope_from": 0.1 * k, "slope_to": 0.1 * k + 0.1, "gain": 1.1 - 0.1 * k, "interval": [0.5, 1.3]}
        for k in range(3)
    ]
    dots = circles(gain_chart({"contact": bins, "rim": []}), "dot-first")
    assert [x for x, _ in dots] == sorted(x for x, _ in dots)
    assert dots[0][1] < dots[1][1] < dots[2][1]
    assert gain_chart({"contact": [], "rim": []}) == ""
    beyond = [{**one, "gain": one["gain"] - 0.3} for one in bins]
    both = gain_chart({"contact": bins, "rim": beyond})
    for first, second in zip(circles(both, "dot-first"), circles(both, "dot-second")):
        assert first[0] == second[0]
        assert first[1] < second[1], "up to the rim slopes are read too flat"


def test_the_learning_chart_has_every_draw_and_what_is_expected(learning):
    drawn = learning_chart(learning)
    assert len(circles(drawn, "draw")) == sum(len(p["draws_deg"]) for p in learning["points"])
    (now, _), (later, _) = circles(drawn, "expected")
    assert now < later
    assert f"now: {learning['expected']['presses_now']}" in drawn


def test_shares_far_off_stand_out():
    bins = [
        {"slope_from": 0.1 * k, "slope_to": 0.1 * k + 0.1, "share": s} for k, s in enumerate((0.68, 0.5, 0.2))
    ]
    root = ElementTree.fromstring(sigma_chart({"by_slope": bins}))
    assert [rect.get("class") for rect in root.iter("rect")] == ["bar", "bar off", "bar far"]
    assert sigma_chart({"by_slope": []}) == ""


def test_markers_lie_between_their_limits():
    (x, _), *_ = circles(limit_bar(2.0, [1.5, 2.5], 3, 5), "marker")
    zones = ElementTree.fromstring(limit_bar(2.0, [1.5, 2.5], 3, 5)).iter("rect")
    assert 0 < x < float(next(zones).get("width"))
    (far, _), *_ = circles(limit_bar(50.0, None, 3, 5), "marker")
    assert far <= 200


def test_ranges_share_a_scale():
    one, two = ({"normal_free_deg": v, "chosen": False} for v in (2.0, 4.0))
    assert circles(range_bar(two, 5), "dot-first")[0][0] == pytest.approx(
        2 * circles(range_bar(one, 5), "dot-first")[0][0]
    )
