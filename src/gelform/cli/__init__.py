"""The command line: a shell over the library. Each command parses, calls and reports."""

from __future__ import annotations

import os
import sys

import typer

from gelform.cli import calibrate, compare, demo, design, evaluate, import_, info, reconstruct, simulate
from gelform.errors import GelformError

app = typer.Typer(
    name="gelform",
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
app.command()(simulate.simulate)
app.command()(design.design)
app.command("import")(import_.import_)
app.command()(compare.compare)
app.command()(info.info)


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
) -> None:
    """Depth in millimetres from the image of an RGB visual-tactile sensor.

    \b
    Without a sensor:  gelform demo -o gelform-demo
    With one:          gelform calibrate presses/ -o cal.npz
                       gelform reconstruct frame.png -c cal.npz -o out --format npz,png
    """


def main(arguments: list[str] | None = None) -> None:
    """Run the command line: a mistake of the user's becomes one line and status 1, a wrong usage status 2.

    With GELFORM_DEBUG set, the traceback comes too.
    """
    for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(
            threads, "1"
        )  # with a busy neighbour two BLAS threads are nine times slower than one
    try:
        app(arguments)
    except (GelformError, ValueError, OSError) as problem:
        if os.environ.get("GELFORM_DEBUG"):
            raise
        typer.echo(f"gelform: error: {' '.join(str(problem).split())}", err=True)
        sys.exit(1)
