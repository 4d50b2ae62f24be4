"""What a command shows, and the command as a process: failures, signals, streams of any encoding, one writer per file.

A mistake in the user's input prints one line and exits with status 1, a bug of gelform with status 70. Results that are
doubtful in most frames are kept, and end with status 3. A mistake is a GelformError, an OSError about a file, or a
ValueError that a command converts with `mistakes_in`. Any other exception is a bug.
"""

from __future__ import annotations

import json
import math
import os
import re
import signal
import sys
import threading
import time
import traceback
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

from gelform.cli.options import Json, Quiet
from gelform.errors import DOUBTFUL, DataError, FrameTally, GelformError, Progress, counted, no_progress

LINE_EVERY_S = 30.0  # between lines of progress in a file, which keeps them
STAGE_AFTER_S = 1.0  # from the start of work; from then on each stage has a line there
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
        """Show a bar for each kind of work on standard error, or lines where that is no terminal; yields what updates it."""
        if self.quiet or sys.stderr is None:
            yield no_progress
            return
        if not sys.stderr.isatty():
            last, stages = time.monotonic(), set[str]()
            long_s = last + STAGE_AFTER_S

            def line(done: int, total: int, what: str) -> None:
                nonlocal last
                now = time.monotonic()
                if now - last >= LINE_EVERY_S or (now >= long_s and what not in stages):
                    last = now
                    stages.add(what)
                    say(f"{what}: {done} of {total}" if total else f"{what}: {done}")

            yield line
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


MISTAKE, DOUBT, BUG, INTERRUPTED = 1, 3, 70, 130
DEBUG = "--debug"
_USAGE: Any = typer.BadParameter.__bases__[0]  # click's UsageError, from the click that typer uses


@contextmanager
def mistakes_in(what: object) -> Iterator[None]:
    """Convert a ValueError or TypeError about one input of the user into a DataError that names it.

    It belongs around the call that reads or checks that input, and no more: a later failure is a bug.
    """
    try:
        yield
    except (ValueError, TypeError) as problem:
        raise DataError(f"{what}: {problem}") from problem


class ReportedFailures(TyperGroup):
    """The group of all commands; reports their exceptions, without a traceback unless `--debug` is given."""

    def make_context(self, *given: Any, **extra: Any) -> Any:
        """Parse the options before the command."""
        try:
            with _usage_printable():
                return super().make_context(*given, **extra)
        except KeyboardInterrupt as problem:
            sys.exit(_report(problem))

    def invoke(self, ctx: Any) -> Any:
        """Run the requested command."""
        try:
            with _usage_printable():
                return super().invoke(ctx)
        except (typer.Exit, typer.Abort, _USAGE, BrokenPipeError):
            raise
        except (Exception, KeyboardInterrupt) as problem:
            if ctx.params.get("debug"):
                traceback.print_exc()
            sys.exit(_report(problem))


@contextmanager
def _usage_printable() -> Iterator[None]:
    """Write codes that steer a terminal as text where a usage error repeats an argument."""
    try:
        yield
    except _USAGE as problem:
        problem.message = printable(problem.message)
        raise


def _report(problem: BaseException) -> int:
    """Print the problem; return the exit status."""
    status = MISTAKE
    if isinstance(problem, KeyboardInterrupt):
        text, status = "interrupted.", INTERRUPTED
    elif isinstance(problem, MemoryError):
        text = "error: not enough memory for this. Use smaller images, or fewer at a time."
    elif isinstance(problem, OSError) and problem.strerror:
        text = f"error: {problem.strerror}{'' if problem.filename is None else f': {problem.filename}'}."
    elif isinstance(problem, OSError | GelformError):
        text = f"error: {problem}"
    else:
        text, status = (
            f"bug: {type(problem).__name__}: {problem} ({_place(problem)}). This is a mistake in gelform, not in your "
            f"input. Please report it, with the output of the same command as `gelform {DEBUG} ...`.",
            BUG,
        )
    say(f"gelform: {in_options(one_line(text))}")
    return status


def one_line(text: object) -> str:
    """A message on one line."""
    return " ".join(str(text).split())


def in_options(text: str) -> str:
    """A library message in the words of the command line: "give mm_per_px= (--mm-per-px)" becomes the option alone."""
    return re.sub(r"\b\w+=\w* \((--[a-z-]+)\)", r"\1", text)


def _place(problem: BaseException) -> str:
    """The file and line of gelform that raised the exception."""
    frames = traceback.extract_tb(problem.__traceback__)
    package = os.path.dirname(os.path.dirname(__file__))
    own = [frame for frame in frames if frame.filename.startswith(package)] or list(frames)
    return f"{os.path.relpath(own[-1].filename, package)}, line {own[-1].lineno}" if own else "place unknown"


@contextmanager
def as_process() -> Iterator[None]:
    """Set up the process: streams take any text, SIGTERM and SIGHUP end it as Ctrl-C does, lost output is reported.

    SIGHUP comes when the terminal closes, such as an ssh session; a process under `nohup` ignores it, and still does.
    """
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # None if the stream is closed
            stream.reconfigure(errors="backslashreplace")
    on_main = threading.current_thread() is threading.main_thread()
    ending = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if on_main and hasattr(signal, name)]
    before = {one: signal.getsignal(one) for one in ending}
    for one, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(one, _interrupt)
    try:
        yield
        _flush()
    except SystemExit:
        _flush()
        raise
    except OSError as problem:  # about the output itself; commands report their own
        _lose_output(problem)
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


def _interrupt(number: int, _: Any) -> NoReturn:
    # The system and the shell both send SIGHUP, and the second must not end the cleaning up.
    if number != signal.SIGTERM:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def _flush() -> None:
    """Write the rest of standard output; drop it silently if its reader is gone (`| head`)."""
    if sys.stdout is None or sys.stdout.closed:
        return
    try:
        sys.stdout.flush()
    except OSError as problem:
        _lose_output(problem)


def _lose_output(problem: OSError) -> None:
    """Report why the output is lost, unless its reader is gone; Python would try again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if not isinstance(problem, BrokenPipeError):
        with suppress(OSError):  # the terminal itself may be gone
            sys.stderr.write(f"gelform: error: cannot write the output: {problem.strerror}.\n")
        sys.exit(1)


@contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Reserve a file's name while the file is made; the system releases it however the process ends.

    DataError: another process is making the same file, or the folder cannot be written to.
    """
    from filelock import FileLock, Timeout  # takes a tenth of a second, and most commands lock nothing

    if not path.parent.is_dir():  # the lock would make it
        raise DataError(f"Cannot write into {path.parent}: there is no such folder.")
    lock = FileLock(path.with_name(f".{path.name}.lock"), timeout=0)
    try:
        lock.acquire()
    except Timeout as problem:
        raise DataError(
            f"Another gelform is making {path} now. Wait for it, or choose another name."
        ) from problem
    except OSError as problem:
        raise DataError(f"Cannot write into {path.parent}: {problem.strerror or problem}.") from problem
    try:
        yield
    finally:
        with suppress(OSError):  # Windows deletes no open file, but the lock does there
            os.unlink(lock.lock_file)
        lock.release()


def status_of(tally: FrameTally, *, accept_doubtful: bool, quiet: bool) -> int:
    """Say the findings and errors of all frames; return the exit status."""
    by_count = sorted(tally.findings.items(), key=lambda one: (-one[1], one[0]))
    if by_count:
        percents = [(name, 100 * count / tally.frames) for name, count in by_count]
        shares = [f"{name} {'under 1' if percent < 1 else f'{percent:.0f}'} %" for name, percent in percents]
        say(f"Findings in {counted(tally.frames, 'frame')}: {', '.join(shares)}.", quiet)
    if tally.failed:
        kind, count = max(tally.reasons.items(), key=lambda one: one[1])
        all_of = f"{tally.failed} of {counted(tally.frames + tally.failed, 'frame')} failed"
        common = "Each" if count == tally.failed == 1 else f"The commonest reason ({counted(count, 'frame')})"
        say(f"gelform: error: {all_of}. {common}: {tally.examples[kind]}")
    if tally.frames and tally.is_useless:
        say(f"gelform: error: no frame was usable: depth is known in none of {tally.frames}.")
        return MISTAKE
    if not tally.is_doubtful:
        return MISTAKE if tally.failed else 0
    causes = ", ".join(f"{name} in {count}" for name, count in by_count if name in DOUBTFUL)
    say(
        f"gelform: error: the depth of {tally.doubtful} of {counted(tally.frames, 'frame')} is doubtful "
        f"({causes or 'it is unknown'}). "
        "Are calibration and background of this sensor, with this gel and light? If they are: --accept-doubtful."
    )
    if tally.failed:
        return MISTAKE
    return 0 if accept_doubtful else DOUBT
