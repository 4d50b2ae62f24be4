"""gelform verify: the output of a batch read again, whole."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gelform.cli.console import print_json, progress_shown, say
from gelform.cli.failures import MISTAKE
from gelform.cli.options import Json, Quiet

SHOWN = 20


def verify(
    output: Annotated[Path, typer.Argument(metavar="OUTPUT", help="Folder that gelform batch wrote.")],
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Read everything that a batch wrote and say what is missing, altered or in excess.

    The exit status is 1 where something is wrong. Frames that have an error of their own are counted, and are
    nothing wrong with the output.

    \b
    Examples:
      gelform verify depth
      gelform verify depth --json
    """
    from gelform.batch import verify_output

    with progress_shown(quiet or as_json) as progress:
        good, errors, problems = verify_output(output, progress)
    if as_json:
        listed = [{"path": str(one.path), "what": one.what} for one in problems]
        print_json({"frames": good, "errors": errors, "problems": listed})
    else:
        for one in problems[:SHOWN]:
            say(f"gelform: error: {one.path}: {one.what}")
        if len(problems) > SHOWN:
            say(f"{len(problems) - SHOWN} more; all with --json.")
    say(f"{good} frames are whole, {errors} have an error, {len(problems)} problems.", quiet or as_json)
    if problems:
        raise typer.Exit(MISTAKE)
