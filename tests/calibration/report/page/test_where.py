"""The tables by slope and by place: every figure of the content stands in them, at its slope and in its row."""

from gelform.calibration.report.page.where import where_section

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


def test_slopes_stand_in_their_rows_and_a_missing_bin_is_a_dash():
    page = where_section({"where": WHERE})
    assert (
        "2.12° inside the edge of the contact, at 0.84 of the visible radius; 3.36° up to 3 px inside" in page
    )
    assert "<td>0.1 – 0.2</td><td>1.11°</td><td>1.99°</td><td>1.02</td><td>500</td>" in page
    assert "<td>0.7 – 0.8</td><td>4.44°</td><td>–</td><td>0.91</td><td>90</td>" in page


def test_places_stand_row_by_row():
    page = where_section({"where": WHERE})
    assert (
        "<tr><td>1.00° / 1.50°</td><td>2.00° / 2.60°</td></tr><tr><td>– / 7.00°</td><td>3.00° / –</td></tr>"
        in page
    )
