"""Maps: cells and marks lie where the frame has them; arrows point along the error."""

import xml.etree.ElementTree as ElementTree

import pytest

from gelform.calibration.report.page.maps import (
    WIDTH,
    coverage_map,
    scale_of_errors,
    share_map,
    slope_error_map,
)

SHAPE = (60, 80)


def elements(drawn, tag, kind):
    return [e for e in ElementTree.fromstring(drawn).iter(tag) if e.get("class") == kind]


def coverage(counts):
    place = {"x_px": 59.5, "y_px": 14.5, "contact_radius_px": 10.0}
    return {"rows": 1, "columns": 2, "presses": counts, "next": [place]}


def test_a_petal_is_empty_where_no_press_was():
    drawn = coverage_map(coverage([[0, 1, 2, 3, 9, 0, 0, 0], [1] * 8]), SHAPE)
    petals = elements(drawn, "path", "petal")
    assert len(petals) == 12
    assert len(elements(drawn, "path", "petal none")) == 4
    opacities = [float(p.get("fill-opacity")) for p in petals[:4]]
    assert opacities[0] < opacities[1] < opacities[2] == opacities[3]


def test_the_next_press_is_drawn_at_its_place():
    mark = elements(coverage_map(coverage([[0] * 8] * 2), SHAPE), "circle", "next")[0]
    scale = WIDTH / 80
    assert float(mark.get("cx")) == pytest.approx(60 * scale, abs=0.1)
    assert float(mark.get("cy")) == pytest.approx(15 * scale, abs=0.1)
    assert float(mark.get("r")) == pytest.approx(10 * scale, abs=0.1)


def test_octant_zero_points_to_the_right():
    first = elements(coverage_map(coverage([[1] * 8] * 2), SHAPE), "path", "petal")[0].get("d")
    start = [float(v) for v in first[1:].split("L")[0].split()]
    line = [float(v) for v in first.split("L")[1].split("A")[0].split()]
    assert line[0] > start[0]


def test_arrows_point_along_the_error_and_empty_cells_stay_blank():
    errors = {
        "rows": 2,
        "columns": 2,
        "rms": [0.1, 0.2, None, 0.05],
        "mean": [[0.1, 0], [0, 0.2], None, [0, 0]],
    }
    drawn = slope_error_map(errors, SHAPE)
    assert len(elements(drawn, "rect", "heat")) == 3
    right, down, still = elements(drawn, "line", "arrow")
    assert float(right.get("x2")) > float(right.get("x1"))
    assert right.get("y2") == right.get("y1")
    assert float(down.get("y2")) > float(down.get("y1"))
    assert still.get("x2") == still.get("x1")
    assert scale_of_errors({"rms": [None]}) == 1.0


def test_shares_are_written_into_their_cells():
    sigma = {"rows": 1, "columns": 3, "by_place": [0.68, None, 0.3]}
    texts = [e.text for e in ElementTree.fromstring(share_map(sigma, SHAPE)).iter("text")]
    assert texts == ["68 %", "–", "30 %"]
