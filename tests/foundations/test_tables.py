"""Tables: text comes back as it was, and no cell begins as a formula does."""

import csv
import io

from hypothesis import given
from hypothesis import strategies as st

from gelform.foundations.tables import plain_cell, table_text

TEXT = st.text(st.sampled_from("=+-@'\t\r\n,\"ab1."), max_size=6)


@given(st.lists(st.lists(TEXT, min_size=2, max_size=4), min_size=1, max_size=4))
def test_text_comes_back_and_is_no_formula(rows):
    read = list(csv.reader(io.StringIO(table_text(rows), newline="")))
    assert [[plain_cell(cell) for cell in row] for row in read] == rows
    for cell in (cell for row in read for cell in row if cell[:1] and cell[0] in "=+-@\t\r"):
        float(cell)  # a number


def test_numbers_stay_numbers():
    assert (
        table_text([["=1+1", "-1.5", "-1e-3", -2, 0.25, "-x", None, "'a"]])
        == "'=1+1,-1.5,-1e-3,-2,0.25,'-x,,'a\n"
    )
