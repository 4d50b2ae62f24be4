"""Rows of tables that list presses: columns that have to be there, numbers that have to be numbers."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gelform.checks import check_positive
from gelform.errors import DataError

MIN_BALL_MM, MAX_BALL_MM = 0.1, 200.0
MIN_HEIGHT_MM, MAX_HEIGHT_MM = 0.01, 20.0


def table_rows(path: Path, columns: tuple[str, ...]) -> Iterator[tuple[str, dict[str, str]]]:
    """Rows of a CSV with where they stand, after its columns were checked.

    Raises
    ------
    DataError
        A column is missing, a row has more fields than there are columns, or the file is no text.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            missing = [c for c in columns if c not in (reader.fieldnames or [])]
            if missing:
                there = ", ".join(reader.fieldnames or []) or "none"
                raise DataError(
                    f"Expected the columns {', '.join(columns)} in {path}, got {there}: {', '.join(missing)} missing."
                )
            for row in reader:
                if None in row:
                    raise DataError(
                        f"Expected {len(reader.fieldnames or [])} fields, got "
                        f"{len(row) - 1 + len(row[None])} ({path}, line {reader.line_num}). Was a decimal comma meant? "
                        "Write 6.35, or quote texts that have commas."
                    )
                if any((value or "").strip() for value in row.values() if isinstance(value, str)):
                    where = f"{path}, line {reader.line_num}"
                    yield where, {k: (v or "").strip() for k, v in row.items() if isinstance(k, str)}
    except UnicodeDecodeError as problem:
        raise DataError(
            f"{path} is no table of text in UTF-8: byte {problem.start} is none. Save it as UTF-8."
        ) from problem
    except csv.Error as problem:
        raise DataError(f"{path} is no table of comma-separated text: {problem}.") from problem
    except OSError as problem:
        raise DataError(f"Cannot read {path}: {problem.strerror or problem}.") from problem


def diameter(text: str, where: str) -> float:
    """A ball's diameter in mm, of a table."""
    try:
        return check_ball_diameter(number(text, "ball diameter", where))
    except ValueError as problem:
        raise DataError(f"{problem} ({where})") from None


def check_ball_diameter(ball_diameter_mm: float) -> float:
    """A ball's diameter in mm: 0.1 to 200; TypeError or ValueError for others."""
    value = check_positive(ball_diameter_mm, "ball_diameter_mm")
    if value > MAX_BALL_MM:
        raise ValueError(f"Expected ball_diameter_mm up to {MAX_BALL_MM:g} mm, got {value:g}.")
    if value < MIN_BALL_MM:
        raise ValueError(
            f"Expected ball_diameter_mm of at least {MIN_BALL_MM:g} mm, got {value:g}. Is it in mm?"
        )
    return value


def height(text: str, where: str) -> float:
    """How far a flat punch stands over the gel around it, mm, of a table: 0.01 to 20."""
    value = number(text, "height_mm", where)
    if not MIN_HEIGHT_MM <= value <= MAX_HEIGHT_MM:
        raise DataError(
            f"Expected height_mm of {MIN_HEIGHT_MM:g} to {MAX_HEIGHT_MM:g} mm, got {value:g}. Is it in mm? ({where})"
        )
    return value


def number(text: str, name: str, where: str) -> float:
    """A finite number of a table."""
    try:
        value = float(text)
    except ValueError:
        raise DataError(f"Expected {name} as a number, got {text!r} ({where}).") from None
    if not np.isfinite(value):
        raise DataError(f"Expected {name} as a finite number, got {text!r} ({where}).")
    return value
