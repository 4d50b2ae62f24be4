"""gelform simulate: images with exact truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gelform.cli.console import print_json, progress_shown, say
from gelform.cli.failures import mistakes_in
from gelform.cli.options import Json, Quiet, positive
from gelform.cli.tables import LAYOUTS, SENSORS, listed
from gelform.errors import DataError

if TYPE_CHECKING:
    from gelform.simulate import HeightMap, Indenter, SimulatedSensor
    from gelform.simulate.twin import Twin

MAX_MAP_BYTES = 1 << 28
GREY_SHAPE, GREY_LEVEL = (240, 320, 3), 110.0  # the background of tables that come without one
TABLES_NOISE = 1.0


def simulate(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="A new or empty folder.")],
    sensor: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE.toml",
            help=f"{listed(LAYOUTS + SENSORS)} ({LAYOUTS[0]} by default); or your own as TOML.",
        ),
    ] = None,
    like: Annotated[
        Path | None,
        typer.Option(
            metavar="CAL.npz",
            help="Instead: answer as this calibrated sensor does, or as Taxim's tables say.",
        ),
    ] = None,
    background: Annotated[
        Path | None, typer.Option(metavar="IMG", help="The untouched image behind Taxim's tables; else grey.")
    ] = None,
    mm_per_px: Annotated[
        float | None,
        typer.Option(
            metavar="F", parser=positive, help="Pixel pitch of that image, mm: the tables hold none."
        ),
    ] = None,
    count: Annotated[int, typer.Option(min=1, help="How many presses of balls.")] = 40,
    ball_diameter_mm: Annotated[
        list[float],
        typer.Option(
            metavar="F", parser=positive, help="Diameter of a ball, mm; give several, they take turns."
        ),
    ] = [6.0, 9.0],  # noqa: B006, typer reads it and never changes it
    height_map: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Press this instead: heights in mm (.npy), or a grey image."),
    ] = None,
    height_map_mm_per_px: Annotated[
        float | None, typer.Option(metavar="F", parser=positive, help="Its sample pitch, mm.")
    ] = None,
    height_map_range_mm: Annotated[
        float | None, typer.Option(metavar="F", help="Of a grey image: how high white stands over black, mm.")
    ] = None,
    depth_mm: Annotated[
        float,
        typer.Option(metavar="F", parser=positive, help="How deep the height map or mesh is pressed, mm."),
    ] = 0.5,
    mesh: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Press this instead: .stl, .ply or .obj (trimesh).")
    ] = None,
    mesh_mm_per_unit: Annotated[
        float, typer.Option(metavar="F", parser=positive, help="Its unit: 1 for mm, 1000 for metres.")
    ] = 1.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the random numbers.")] = 0,
    workers: Annotated[
        int, typer.Option(min=1, help="Processes; the bytes are the same for any number.")
    ] = 1,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Simulate a sensor: images of pressed balls, or of your own height map or mesh, with the exact truth.

    Balls make a press folder that `gelform calibrate` reads: background.png, presses.csv with labels,
    sensor.toml, images/, and truth/ with depth_mm, gradients, contact and more of each image. A height map
    or a mesh makes background.png, image.png, truth.npz.

    \b
    Examples:
      gelform simulate -o presses
      gelform simulate -o presses --sensor homemade --count 60 --ball-diameter-mm 5 --ball-diameter-mm 8
      gelform simulate -o presses --sensor digit --count 10000 --workers 8
      gelform simulate -o presses --sensor mine.toml
      gelform simulate -o twin --like cal.npz --count 1000 --workers 4
      gelform simulate -o gear --like cal.npz --mesh gear.stl
      gelform simulate -o taxim --like polycalib.npz --background rest.png --mm-per-px 0.03
      gelform simulate -o key --height-map key.npy --height-map-mm-per-px 0.02 --depth-mm 0.6
      gelform simulate -o coin --height-map coin.png --height-map-mm-per-px 0.02 --height-map-range-mm 0.3
      gelform simulate -o gear --mesh gear.stl --sensor gelsight-mini
    """

    if sum(given is not None for given in (sensor, like)) > 1 or None not in (height_map, mesh):
        raise typer.BadParameter("give one sensor and one thing to press.", param_hint="--sensor, --like")
    twin = _twin_of(like, background, mm_per_px)
    if twin is not None:
        made = twin.sensor
    else:
        made = sensor_of(sensor or LAYOUTS[0])
    with progress_shown(quiet) as progress:
        if height_map is not None or mesh is not None:
            face = (
                _mesh(mesh, mesh_mm_per_unit)
                if height_map is None
                else _height_map(height_map, height_map_mm_per_px, height_map_range_mm)
            )
            from gelform.exporters.simulated_press import save_simulated_press

            save_simulated_press(output, made, face, depth_mm=depth_mm, seed=seed, twin=twin)
        else:
            from gelform.exporters.simulated_sets import SetOfPresses, save_simulated_set

            oversample = 1 if twin is not None else 3  # a look answers to the slope at the pixel's centre
            wanted = SetOfPresses(made, tuple(ball_diameter_mm), count, seed, oversample, twin)
            save_simulated_set(output, wanted, workers=workers, progress=progress)
    say(f"Wrote {output}.", quiet or as_json)
    if as_json:
        presses = count if height_map is None and mesh is None else 1
        name = made.name if like is None else f"like {like}"
        print_json({"folder": output, "sensor": name, "presses": presses, "seed": seed})


def sensor_of(name_or_file: str) -> SimulatedSensor:
    """A ready sensor by name, or one from a TOML file."""
    from gelform.sensors.simulated.settings import read_simulated_sensor, simulated_sensor_named

    if name_or_file.endswith(".toml"):
        return read_simulated_sensor(name_or_file)
    try:
        return simulated_sensor_named(name_or_file)
    except ValueError as problem:
        raise typer.BadParameter(str(problem), param_hint="--sensor") from problem


def _twin_of(path: Path | None, background: Path | None, mm_per_px: float | None) -> Twin | None:
    """A twin of a calibration or of Taxim's tables; None without either."""
    from gelform.calibration_file import load_calibration
    from gelform.importers.taxim_forward import is_taxim_forward
    from gelform.simulate.twin import Twin

    if path is not None and path.is_file() and is_taxim_forward(path):
        return _twin_of_tables(path, background, mm_per_px)
    for given, name in ((background, "--background"), (mm_per_px, "--mm-per-px")):
        if given is not None:
            raise typer.BadParameter("is for --like with Taxim's tables only.", param_hint=name)
    return None if path is None else Twin(load_calibration(path))


def _twin_of_tables(path: Path, background: Path | None, mm_per_px: float | None) -> Twin:
    import numpy as np

    from gelform.importers.taxim_forward import TaximLook, read_taxim_forward
    from gelform.sensors.files import read_image
    from gelform.simulate.twin import Twin

    if mm_per_px is None:
        raise typer.BadParameter("needed with Taxim's tables: they hold none.", param_hint="--mm-per-px")
    rest = np.full(GREY_SHAPE, GREY_LEVEL) if background is None else read_image(background)
    noise = np.full(3, TABLES_NOISE)
    return Twin(TaximLook(read_taxim_forward(path), rest.astype(np.float32), mm_per_px, noise))


def _mesh(path: Path | None, mm_per_unit: float) -> Indenter:
    from gelform.importers.relief import read_mesh

    assert path is not None
    try:
        return read_mesh(path, mm_per_unit=mm_per_unit)
    except ImportError as problem:
        raise DataError(str(problem)) from problem


def _height_map(path: Path, mm_per_px: float | None, range_mm: float | None) -> HeightMap:
    import numpy as np

    from gelform.importers.relief import read_height_image
    from gelform.simulate import HeightMap

    if mm_per_px is None:
        raise typer.BadParameter("needed with --height-map.", param_hint="--height-map-mm-per-px")
    if path.suffix.lower() != ".npy" and range_mm is not None:
        return read_height_image(path, mm_per_px=mm_per_px, height_mm=range_mm)
    if not path.is_file():
        raise DataError(f"No file {path}: expected heights in mm as .npy.")
    if path.stat().st_size > MAX_MAP_BYTES:
        raise DataError(
            f"Expected a height map of at most {MAX_MAP_BYTES >> 20} MB, got {path}. Reduce it first."
        )
    try:
        heights = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, OSError) as problem:
        raise DataError(
            f"{path} is no array file (.npy) of numbers, or a damaged one. Is it a grey "
            "image? Say --height-map-range-mm."
        ) from problem
    if not isinstance(heights, np.ndarray):
        raise DataError(f"Expected one array (.npy) in {path}, got an archive. Save the heights alone.")
    with mistakes_in(path):
        return HeightMap(heights, mm_per_px)
