"""Tables that list presses: what is no number, no ball or one field too many is refused with its line."""

import pytest

from gelform.calibration.presses.tables import diameter, number, table_rows
from gelform.errors import DataError

COLUMNS = ("image", "ball_diameter_mm")


def table(tmp_path, text):
    path = tmp_path / "presses.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_rows_come_with_their_line(tmp_path):
    path = table(tmp_path, "\ufeffimage,ball_diameter_mm,note\r\n a.png , 6 ,\r\n\r\nb.png,7,x\r\n")
    (where, first), (_, second) = table_rows(path, COLUMNS)
    assert first == {"image": "a.png", "ball_diameter_mm": "6", "note": ""}
    assert second["image"] == "b.png"
    assert where.endswith("presses.csv, line 2")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("image,size\na.png,6\n", r"got image, size: ball_diameter_mm missing"),
        ("", "got none"),
        (b"\xff\xfe\x00", "no table"),
        ("image,ball_diameter_mm\na.png,6,35\n", r"2 fields, got 3 .*line 2.* decimal comma.* 6\.35"),
        ("image,ball_diameter_mm\n0.png,6\na.png,6,,,\n", r"2 fields, got 5 .*line 3"),
    ],
)
def test_what_is_no_such_table_is_refused(tmp_path, text, said):
    with pytest.raises(DataError, match=said):
        list(table_rows(table(tmp_path, text), COLUMNS))


@pytest.mark.parametrize("text", ["nan", "inf", "six", "", "1e999"])
def test_numbers_are_finite(text):
    with pytest.raises(DataError, match=r"radius as a .*number, got .* \(line 3\)"):
        number(text, "radius", "line 3")


@pytest.mark.parametrize("text", ["0", "-6", "300", "nan"])
def test_balls_have_a_size(text):
    with pytest.raises(DataError, match="line 3"):
        diameter(text, "line 3")
    assert diameter("6.35", "line 3") == 6.35
