"""Tables as text with commas, whose cells no spreadsheet takes for formulas."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable
from typing import Any

# A spreadsheet runs text that begins so (OWASP, CSV injection); one more apostrophe keeps text that has some already.
_FORMULA = re.compile(r"'*[=+\-@\t\r]")


def table_text(rows: Iterable[Iterable[Any]]) -> str:
    """Rows of cells as lines of a CSV file; an apostrophe comes before text that a spreadsheet would run as a formula."""
    return "".join(map(_line, rows))


def plain_cell(cell: str) -> str:
    """A cell as it was before `table_text`."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def _line(row: Iterable[Any]) -> str:
    text = io.StringIO()
    csv.writer(text).writerow(
        map(_safe, row)
    )  # with another end of lines, a lone carriage return would not be quoted
    return text.getvalue().removesuffix("\r\n") + "\n"


def _safe(cell: Any) -> Any:
    return f"'{cell}" if isinstance(cell, str) and _FORMULA.match(cell) and not _is_number(cell) else cell


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
