"""gelform design: which LED layout gives the least depth error."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gelform.cli.console import check_pictures, figure, print_json, progress_shown, say, show_table
from gelform.cli.options import Json, Overwrite, Quiet
from gelform.cli.result_names import check_output


def design(
    sensor: Annotated[
        str, typer.Argument(metavar="SENSOR.toml", help="A simulated sensor, or a ready one's name.")
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE.png", help="A picture of the study.")
    ] = None,
    presses: Annotated[int, typer.Option(min=4, help="Ball presses to calibrate each design on.")] = 14,
    seed: Annotated[int, typer.Option(min=0, help="Of the random numbers.")] = 0,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Compare designs of a sensor before it is built: lights, crosstalk, noise, gel.

    Each is simulated, calibrated on ball presses and measured on others, whose depth is known exactly. The
    slope noise and the condition of the lights say where on the gel a design is weak, whatever the calibration.

    \b
    Examples:
      gelform design mine.toml -o design.png
      gelform design three-edges --json
    """
    import numpy as np

    from gelform.cli.commands.simulate import sensor_of
    from gelform.design.study import compare_designs

    chosen = sensor_of(sensor)
    if output is not None:
        check_pictures()
        check_output(output, overwrite=overwrite)
    with progress_shown(quiet) as progress:
        results = compare_designs(chosen, presses=presses, seed=seed, progress=progress)
    if output is not None:
        from gelform.design.picture import design_picture
        from gelform.plots.canvas import save_picture

        save_picture(output, design_picture(results), overwrite=overwrite)
    rows = [
        {
            "design": result.name,
            "depth_rmse_um": result.depth_rmse_um,
            "depth_rmse_se_um": result.depth_rmse_se_um,
            "normal_deg": result.normal_deg,
            "slope_sigma": float(np.median(result.slope_sigma)),
            "condition": float(np.median(result.condition)),
        }
        for result in results
    ]
    if as_json:
        print_json({"sensor": chosen.name, "designs": rows})
        return
    lines = [[str(row["design"]), *(figure(row[name]) for name in list(row)[1:])] for row in rows]  # type: ignore[arg-type]
    show_table(f"Designs of {chosen.name}", list(rows[0]), lines)
    say(f"Wrote {output}." if output is not None else "", quiet or output is None)
