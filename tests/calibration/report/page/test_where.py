"""The tables by slope and by place: every figure of the content stands in them, at its slope and in its row."""

from gelform.calibration.report.page.where import where_section

WHERE = {
    "inner_zone": 0.8,
    "contact": {
        "normal_deg": 2.12,
        "by_slope": [
            {"slope_from": 0.1, "slope_to": 0.2, "normal_deg": 1.11, "gain": 1.02, "pixels": 500},
            {"slope_from": 0.7, "slope_to": 0.8, "normal_deg": 4.44, "gain": 0.71, "pixels": 90},
        ],
        "by_place": {"rows": 2, "columns": 2, "normal_deg": [1.0, 2.0, None, 3.0], "pixels": [99, 99, 0, 99]},
    },
    "inner": {
        "normal_deg": 1.36,
        "by_slope": [{"slope_from": 0.1, "slope_to": 0.2, "normal_deg": 0.99, "gain": 1.01, "pixels": 400}],
        "by_place": {"rows": 2, "columns": 2, "normal_deg": [0.5, 0.6, None, None], "pixels": [99, 99, 0, 5]},
    },
}


def test_slopes_stand_in_their_rows_and_a_missing_inner_bin_is_a_dash():
    page = where_section({"where": WHERE})
    assert "2.12° in the whole contact less 3 px, 1.36° within 0.8" in page
    assert "<td>0.1 – 0.2</td><td>1.11°</td><td>0.99°</td><td>1.02</td><td>500</td>" in page
    assert "<td>0.7 – 0.8</td><td>4.44°</td><td>–</td><td>0.71</td><td>90</td>" in page


def test_places_stand_row_by_row():
    page = where_section({"where": WHERE})
    assert (
        "<tr><td>1.00° / 0.50°</td><td>2.00° / 0.60°</td></tr><tr><td>– / –</td><td>3.00° / –</td></tr>"
        in page
    )
