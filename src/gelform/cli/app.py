"""The list of commands, and the options that stand before one."""

from __future__ import annotations

import os

import typer

from gelform.cli.commands import (
    batch,
    calibrate,
    demo,
    design,
    export,
    import_,
    lens,
    live,
    reconstruct,
    scale,
    simulate,
    verify,
)
from gelform.cli.commands.inspection import compare, evaluate, explain, info
from gelform.cli.commands.robots import bag, ros
from gelform.cli.commands.sources import cameras, record
from gelform.cli.failures import DEBUG, ReportedFailures
from gelform.cli.process import as_process

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

app = typer.Typer(
    name="gelform",
    cls=ReportedFailures,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,  # plain help: rich takes 0.3 s to start
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
app.command()(demo.demo)
app.command()(calibrate.calibrate)
app.command()(reconstruct.reconstruct)
app.command()(evaluate.evaluate)
app.command()(scale.scale)
app.command()(lens.lens)
app.command()(simulate.simulate)
app.command()(design.design)
app.command("import")(import_.import_)
app.command()(compare.compare)
app.command()(explain.explain)
app.command()(export.export)
app.command()(info.info)
app.command()(cameras.cameras)
app.command()(record.record)
app.command()(live.live)
app.command()(batch.batch)
app.command()(verify.verify)
app.command()(bag.bag)
app.command()(ros.ros)


def command_names() -> tuple[str, ...]:
    """The names of all commands, in the order of the help."""
    return tuple(command.name or str(command.callback.__name__) for command in app.registered_commands)  # type: ignore[union-attr]


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
