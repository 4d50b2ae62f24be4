"""The list of commands, and the options that stand before one."""

from __future__ import annotations

import os

import typer

from gelform.cli.commands.batch import batch, verify
from gelform.cli.commands.calibrate import calibrate
from gelform.cli.commands.demo import demo
from gelform.cli.commands.exchange import export, import_
from gelform.cli.commands.geometry import lens, scale
from gelform.cli.commands.info import info
from gelform.cli.commands.inspection import compare, evaluate, explain
from gelform.cli.commands.live import live
from gelform.cli.commands.reconstruct import reconstruct
from gelform.cli.commands.robots import bag, ros
from gelform.cli.commands.simulate import design, simulate
from gelform.cli.commands.sources import cameras, record
from gelform.cli.options import flat
from gelform.cli.process import DEBUG, ReportedFailures, as_process

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
COMMANDS = (
    *(
        demo,
        calibrate,
        reconstruct,
        evaluate,
        scale,
        lens,
        simulate,
        design,
        import_,
        compare,
        explain,
        export,
    ),
    *(info, cameras, record, live, batch, verify, bag, ros),
)

app = typer.Typer(
    name="gelform",
    cls=ReportedFailures,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,  # plain help: rich takes 0.3 s to start
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
for command in COMMANDS:
    app.command(command.__name__.rstrip("_"))(flat(command))


def command_names() -> tuple[str, ...]:
    """The names of all commands, in the order of the help."""
    return tuple(command.__name__.rstrip("_") for command in COMMANDS)


def _print_version(asked: bool) -> None:
    if asked:
        from gelform import __version__

        typer.echo(f"gelform {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: bool = typer.Option(
        False, "--version", callback=_print_version, is_eager=True, help="Say which version."
    ),
    debug: bool = typer.Option(False, DEBUG, envvar="GELFORM_DEBUG", help="Show the traceback of an error."),
) -> None:
    """Depth in millimetres from the image of an RGB visual-tactile sensor.

    \b
    Without a sensor:  gelform demo -o gelform-demo
    With one:          gelform calibrate presses/ -o cal.npz
                       gelform reconstruct frame.png -c cal.npz -o out --format npz,png
    """


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit: 0, 1 (a mistake in the input), 2 (wrong usage), 70 (a bug), 130 (interrupted)."""
    for threads in THREADS:  # with a busy neighbour two BLAS threads are nine times slower than one
        os.environ.setdefault(threads, "1")
    with as_process():
        app(arguments, prog_name="gelform")
