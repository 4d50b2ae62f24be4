"""The rows of all parts: how often a decision is wrong either way on one set."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from real_frames.sets import percent
from report import table

Row = dict[str, Any]


def row(no: Iterable[bool] = (), yes: Iterable[bool] = (), figures: Iterable[float] = ()) -> Row:
    """Wrong answers where no is right, and where yes is right; least and largest figure of the findings that say yes."""
    no, yes, said = list(map(bool, no)), list(map(bool, yes)), sorted(figures)
    return {
        "no": len(no),
        "no, wrong": sum(no),
        "no, wrong %": percent(no) if no else None,
        "yes": len(yes),
        "yes, wrong": sum(yes),
        "yes, wrong %": percent(yes) if yes else None,
        "figures": [float(said[0]), float(said[-1])] if said else None,
    }


def shown(title: str, rows: dict[str, Row]) -> dict[str, Row]:
    """Print the rows, and return them."""
    found = [[name, *map(_plain, one.values())] for name, one in rows.items()]
    header: Sequence[str] = [title, *(next(iter(rows.values())) if rows else ())]
    print("\n" + table(header, found), flush=True)
    return rows


def _plain(value: Any) -> Any:
    if isinstance(value, list):
        return f"{value[0]:.3g} to {value[1]:.3g}"
    return "" if value is None else value
