"""How many presses are enough: the docs show the same table, and few presses carry few terms."""

import re
from pathlib import Path

from gelform.calibration.enough import NEEDED, REFINING

PAGE = Path(__file__).parents[2] / "docs" / "press-folder.md"


def test_the_docs_show_the_table():
    rows = re.findall(r"^\| (\d+) \| (.*) \| (.*) \|$", PAGE.read_text(encoding="utf-8"), re.M)
    assert rows == [(str(need.presses), need.what, need.why) for need in NEEDED]


def test_enough_begins_at_the_number_of_its_row():
    for need in NEEDED:
        assert (need.met(need.presses - 1), need.met(need.presses)) == (False, True)


def test_few_presses_carry_few_terms():
    for table in (REFINING, list(NEEDED)):
        counts = [row[0] for row in table]
        assert counts == sorted(counts)
    assert REFINING[0][0] == 0, "something is always fitted"
