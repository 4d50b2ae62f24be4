"""Output to the terminal for all commands: progress, tables, JSON."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from gelform.cli.options import Json, Quiet
from gelform.foundations.findings import Progress, no_progress

# What steers a terminal: control codes (C0, DEL, C1), line separators, and marks that turn the direction of writing.
_STEERING = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def printable(text: object) -> str:
    """A line for a terminal: a code that would steer it is written as \\xNN. Names in files may hold any."""
    return _STEERING.sub(lambda code: code[0].encode("unicode_escape").decode("ascii"), str(text))


def say(text: str, quiet: bool = False) -> None:
    """Print a line for the user on standard error, apart from the results."""
    if not quiet:
        typer.echo(printable(text), err=True)


def show(text: str) -> None:
    """Print a line of the results on standard output."""
    typer.echo(printable(text))


@dataclass(frozen=True)
class ShownOption:
    """The output of a command: results on standard output, the rest on standard error."""

    quiet: Quiet = False
    as_json: Json = False

    @property
    def silent(self) -> bool:
        """Whether to print nothing but JSON."""
        return self.quiet or self.as_json

    def say(self, text: str) -> None:
        """Print a line for the user."""
        say(text, self.quiet)

    def json(self, content: Mapping[str, Any]) -> None:
        """Print the numbers as JSON, if requested."""
        if self.as_json:
            print_json(content)

    def table(
        self,
        title: str,
        columns: Mapping[str, str] | Sequence[str],
        rows: Iterable[Mapping[str, Any] | Sequence[Any]],
    ) -> None:
        """Print a table, unless it is empty; its first column is text, the others are numbers.

        Each row is a record, and `columns` has the headings of its keys; or it has a value for each heading.
        """
        if self.silent or not (listed := list(rows)):
            return
        from rich.console import Console
        from rich.table import Table

        table = Table(
            title=printable(title),
            title_justify="left",
            box=None,
            header_style="bold",
            pad_edge=False,
            padding=(0, 2, 0, 0),
        )
        for k, column in enumerate(columns.values() if isinstance(columns, Mapping) else columns):
            table.add_column(column, justify="left" if k == 0 else "right", overflow="fold")
        for row in listed:
            cells = [row[name] for name in columns] if isinstance(row, Mapping) else row
            table.add_row(*(printable(figure(cell)) for cell in cells))
        on_screen = sys.stdout is not None and sys.stdout.isatty()
        wide = None if on_screen else 400  # in a file or a pipe no name is wrapped
        console = Console(highlight=False, markup=False, width=wide)
        console.print(table)
        console.print()

    @contextmanager
    def progress(self) -> Iterator[Progress]:
        """Show a bar for each kind of work on standard error, if that is a terminal; yields the function that updates it."""
        if self.quiet or sys.stderr is None or not sys.stderr.isatty():
            yield no_progress
            return
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bars

        text = TextColumn("{task.description}", markup=False)
        with Bars(
            text, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=Console(stderr=True)
        ) as bars:
            tasks: dict[str, Any] = {}

            def report(done: int, total: int, what: str) -> None:
                if what not in tasks:
                    tasks[what] = bars.add_task(printable(what), total=total or None)
                bars.update(tasks[what], completed=done, total=total or None)

            yield report


def check_pictures() -> None:
    """Check that matplotlib can draw pictures, and silence its warning about its cache where HOME is read-only."""
    import logging

    from gelform.exchange.plots import check_matplotlib

    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    check_matplotlib()


def print_json(content: Mapping[str, Any]) -> None:
    """Print one JSON object on standard output; NaN and infinity become null."""
    utf8 = "utf" in (getattr(sys.stdout, "encoding", None) or "").lower()
    text = json.dumps(_plain(content), indent=2, ensure_ascii=not utf8)
    typer.echo(
        "\n".join(_STEERING.sub(lambda code: f"\\u{ord(code[0]):04x}", line) for line in text.split("\n"))
    )


def json_bytes(content: Mapping[str, Any]) -> bytes:
    """The same JSON as the content of a file."""
    return (json.dumps(_plain(content), indent=2, ensure_ascii=False) + "\n").encode()


def figure(value: Any) -> str:
    """A number for a table; a dash for None, NaN and an empty text."""
    if value is None or value == "" or (isinstance(value, float) and not math.isfinite(value)):
        return "-"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
