"""The list of commands, in the groups of the help, and the options that come before a command."""

from __future__ import annotations

import os
from collections import Counter
from typing import Any

import typer
from typer.core import TyperCommand

import gelform
from gelform.cli.commands import calibrations, force
from gelform.cli.commands.calibrate import calibrate, crosstalk, lens, scale, starter
from gelform.cli.commands.exchange import export, import_
from gelform.cli.commands.info import info
from gelform.cli.commands.inspection import compare, evaluate, explain, measure
from gelform.cli.commands.reconstruct import batch, reconstruct, verify
from gelform.cli.commands.robots import bag, ros, track
from gelform.cli.commands.simulate import demo, design, simulate
from gelform.cli.commands.sources import cameras, live, record
from gelform.cli.console import DEBUG, ReportedFailures, as_process
from gelform.cli.options import flat

# With a busy neighbor two BLAS threads are nine times slower than one. A stream has a thread for each stage, so OpenCV needs
# none of its own. A camera that hangs would block its reader for OpenCV's default of 10 s.
ENVIRONMENT = {
    **dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    "OPENCV_FOR_THREADS_NUM": "1",
    "OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT": "1",
}
SUBCOMMANDS = {"force": force, "calibrations": calibrations}  # commands with commands of their own
GROUPS: dict[str, tuple[Any, ...]] = {
    "Start": (demo, live, simulate, info),
    "Sensor": (cameras, record, scale, lens, crosstalk, calibrate, starter, evaluate, *SUBCOMMANDS, design),
    "Frames": (reconstruct, measure, explain, compare, batch, verify),
    "Robots": (bag, ros, track),
    "Files": (import_, export),
}


def _name(command: Any) -> str:
    return command if isinstance(command, str) else command.__name__.rstrip("_")


class Commands(ReportedFailures):
    """All commands, in groups; `gelform batch verify` is `gelform verify`."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write each group with one line per command."""
        width = max(map(len, command_names()))
        for group, commands in GROUPS.items():
            rows = []
            for name in map(_name, commands):
                said = self.commands[name].get_short_help_str(formatter.width - 6 - width)
                rows.append((name.ljust(width), said))
            with formatter.section(group):
                formatter.write_dl(rows)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The requested command and its arguments."""
        if args[:2] == ["batch", "verify"]:
            return "batch verify", self.commands["verify"], args[2:]
        return super().resolve_command(ctx, args)


class GivenOnce(TyperCommand):
    """A command whose options are given once, unless they take several values: the last one would replace the others."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments; refuse an option that would drop a value."""
        given = Counter(self.make_parser(ctx).parse_args(args=list(args))[2]) if "--help" not in args else {}
        for option, count in given.items():
            if count > 1 and not (option.multiple or getattr(option, "is_flag", False) or option.nargs == -1):
                name = f"'{max(option.opts, key=len)}'"
                raise typer.BadParameter(f"expected once, got {count} times.", param_hint=name)
        return list(super().parse_args(ctx, args))


def _typer(name: str, **settings: Any) -> typer.Typer:
    return typer.Typer(
        name=name,
        no_args_is_help=True,
        rich_markup_mode=None,  # plain help, because importing rich takes 0.3 s
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
        **settings,
    )


app = _typer("gelform", cls=Commands, add_completion=False, pretty_exceptions_enable=False)
for command in (one for commands in GROUPS.values() for one in commands if not isinstance(one, str)):
    app.command(_name(command), cls=GivenOnce)(flat(command))
for name, module in SUBCOMMANDS.items():
    below = _typer(name, help=module.__doc__, short_help=module.SUMMARY)
    for command in module.COMMANDS:
        below.command(_name(command), cls=GivenOnce)(flat(command))
    app.add_typer(below)


def command_names() -> tuple[str, ...]:
    """The names of all commands, in the order of the help."""
    return tuple(_name(command) for commands in GROUPS.values() for command in commands)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"gelform {gelform.__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: bool = typer.Option(
        False, "--version", callback=_print_version, is_eager=True, help="Show the version."
    ),
    debug: bool = typer.Option(False, DEBUG, envvar="GELFORM_DEBUG", help="Show the traceback of an error."),
) -> None:
    """Depth in millimeters from the image of an RGB visual-tactile sensor.

    \b
    Without a sensor:  gelform demo -o gelform-demo
    With one:          gelform calibrate presses/ -o cal.npz
                       gelform reconstruct frame.png -c cal.npz -o out --format npz,png
    """


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit: 0, 1 (a mistake in the input), 2 (wrong usage), 3 (doubtful depth), 70 (a bug), 130."""
    for name, value in ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    with as_process():
        app(arguments, prog_name="gelform")
