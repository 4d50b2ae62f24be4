"""gelform simulate: images with exact truth; gelform design: which LED layout gives the least depth error.

gelform demo: the whole path on a simulated sensor, compared with the truth.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

from typer import BadParameter, Option

import gelform
from gelform import sensors
from gelform import simulate as simulator
from gelform.cli import options
from gelform.cli.console import ShownOption, check_pictures, json_bytes, mistakes_in, say
from gelform.cli.files import check_output, content_of, write_report
from gelform.cli.options import LAYOUTS, argument, listed, number, one_of, option, usage_errors
from gelform.sensors.profiles import SENSORS

LAYOUT, PRESSES, SEED = "three-edges", 24, 7
DEMO_COLUMNS = {  # of the table: heading and format of each error
    "true_peak_mm": ("true peak (mm)", "{:.3f}"),
    "peak_mm": ("peak (mm)", "{:.3f}"),
    "peak_ratio": ("ratio", "{:.1%}"),
    "rmse_um": ("depth RMSE (um)", "{:.1f}"),
    "rmse_contact_um": ("RMSE in contact (um)", "{:.1f}"),
    "normal_contact_deg": ("normals (°)", "{:.1f}"),
}
DESIGN_COLUMNS = {
    "design": "design",
    "depth_rmse_um": "depth RMSE (um)",
    "depth_rmse_se_um": "its standard error (um)",
    "normal_deg": "normal error (°)",
    "slope_sigma": "slope noise (mm/mm)",
    "condition": "condition number (1 is best)",
}


def simulate(
    *,
    output: options.NewFolder,
    sensor: Annotated[
        str | None,
        option(
            "NAME|FILE.toml",
            f"{listed((*LAYOUTS, *SENSORS))} ({LAYOUTS[0]} by default); or your own as TOML.",
        ),
    ] = None,
    like: Annotated[
        Path | None, option("CAL.npz", "Imitate this calibrated sensor, or Taxim's tables.")
    ] = None,
    background: Annotated[
        Path | None, option("IMG", "Background image for Taxim's tables. Default: gray.")
    ] = None,
    mm_per_px: Annotated[
        float | None, number("Width of a background pixel on the gel, mm, for the tables.", options.pitch)
    ] = None,
    count: Annotated[int, Option(min=1, help="Number of ball presses.")] = 40,
    loads: Annotated[
        bool, Option("--loads", help="Write loads.csv for gelform force: 0.1 N per mm^3 of displaced gel.")
    ] = False,
    ball_diameter_mm: Annotated[list[float], number("Diameter of a ball, mm; several alternate.")] = (
        6.0,
        9.0,
    ),  # type: ignore[assignment]  # typer makes a list of it
    height_map: Annotated[Path | None, option("FILE.npy", "Press this height map: heights in mm.")] = None,
    height_map_mm_per_px: Annotated[float | None, number("Sample pitch of the height map, mm.")] = None,
    depth_mm: Annotated[float, number("Depth of the height map, or of the coin of --as, mm.")] = 0.5,
    forms: Annotated[
        str, Option("--as", metavar="FORM,...", help=f"Also a moving press: {', '.join(options.FORMS)}.")
    ] = "",
    seed: options.Seed = 0,
    workers: Annotated[int, Option(min=1, help="Number of processes; any number gives the same bytes.")] = 1,
    shown: ShownOption,
) -> None:
    """Simulate a sensor: images of presses with their truth.

    Presses balls, or your own height map.

    Balls make a press folder that `gelform calibrate` reads: background.png, presses.csv with labels, sensor.toml, images/,
    and truth/ with depth_mm, gradients, contact and more for each image. A height map makes background.png,
    image.png, truth.npz.

    With --as, moving/ has frames of the height map, or of a coin, that is pressed in, slides and turns: files for track,
    batch and live. Its true poses are in motion.csv.

    \b
    Examples:
      gelform simulate -o presses
      gelform simulate -o presses --as video,mcap,hdf5,lerobot
      gelform simulate -o presses --sensor homemade --count 60 --ball-diameter-mm 5 --ball-diameter-mm 8
      gelform simulate -o presses --sensor digit --count 10000 --workers 8
      gelform simulate -o presses --sensor mine.toml
      gelform simulate -o twin --like cal.npz --count 1000 --workers 4
      gelform simulate -o taxim --like polycalib.npz --background rest.png --mm-per-px 0.03
      gelform simulate -o loads --loads --count 12
      gelform simulate -o key --height-map key.npy --height-map-mm-per-px 0.02 --depth-mm 0.6
    """
    from gelform.exchange.exporters import press_folder
    from gelform.foundations.files import read_npy
    from gelform.simulate.press import check_press_depth

    if None not in (sensor, like):
        raise BadParameter("give one sensor.", param_hint="--sensor, --like")
    twin = _twin_of(like, background, mm_per_px)
    made = twin.sensor if twin is not None else sensor_of(sensor or LAYOUTS[0])
    pressed = None
    if height_map is not None:
        if height_map_mm_per_px is None:
            raise BadParameter("needed with --height-map.", param_hint="--height-map-mm-per-px")
        heights = read_npy(height_map, "heights in mm")
        with mistakes_in(height_map):
            pressed = simulator.HeightMap(heights, height_map_mm_per_px)
    moving = [one_of(name.strip(), options.FORMS, "--as") for name in forms.split(",")] if forms else []
    press_folder.check_forms(moving)
    if pressed or moving:
        with usage_errors("--depth-mm"):
            check_press_depth(made, depth_mm)
    with shown.progress() as progress:
        if pressed is not None:
            press_folder.save_simulated_press(output, made, pressed, depth_mm=depth_mm, seed=seed, twin=twin)
        else:
            oversample = 1 if twin is not None else 3  # a twin answers to the slope at the pixel's center
            with usage_errors("--ball-diameter-mm"):
                wanted = press_folder.SetOfPresses(
                    made, tuple(ball_diameter_mm), count, seed, oversample, twin
                )
            press_folder.save_simulated_set(output, wanted, workers=workers, loads=loads, progress=progress)
        if moving:
            pressed_along = pressed or simulator.Coin()
            press_folder.save_moving_press(
                output / "moving", twin or made, pressed_along, moving, depth_mm, seed
            )
    say(f"Wrote {output}.", shown.silent)
    presses = count if pressed is None else 1
    name = made.name if like is None else f"like {like}"
    shown.json({"folder": output, "sensor": name, "presses": presses, "seed": seed, "as": moving})


def sensor_of(name_or_file: str) -> simulator.SimulatedSensor:
    """A ready-made sensor by name, or one from a TOML file."""
    if name_or_file.endswith(".toml"):
        return sensors.read_simulated_sensor(name_or_file)
    with usage_errors("--sensor"):
        return sensors.simulated_sensor_named(name_or_file)


def _twin_of(like: Path | None, background: Path | None, mm_per_px: float | None) -> simulator.Twin | None:
    """A twin of a calibration or of Taxim's tables; None without either."""
    import numpy as np

    from gelform.exchange.importers import TaximLook, is_taxim_forward, read_taxim_forward

    if like is not None and like.is_file() and is_taxim_forward(like):
        if mm_per_px is None:
            raise BadParameter("needed with Taxim's tables: they hold none.", param_hint="--mm-per-px")
        untouched = np.full((240, 320, 3), 110.0) if background is None else gelform.read_image(background)
        noise = np.full(3, 1.0)  # gray levels: the tables state none
        tables = read_taxim_forward(like)
        return simulator.Twin(TaximLook(tables, untouched.astype(np.float32), mm_per_px, noise))
    for given, name in ((background, "--background"), (mm_per_px, "--mm-per-px")):
        if given is not None:
            raise BadParameter("is for --like with Taxim's tables only.", param_hint=name)
    return None if like is None else simulator.Twin(gelform.load_calibration(like))


def design(
    *,
    sensor: Annotated[str, argument("SENSOR.toml", "A simulated sensor, or the name of a ready-made one.")],
    output: Annotated[Path | None, options.output("FILE.png", "A picture of the study.")] = None,
    presses: Annotated[int, Option(min=4, help="Number of ball presses that calibrate each design.")] = 14,
    seed: options.Seed = 0,
    overwrite: options.Overwrite = False,
    shown: ShownOption,
) -> None:
    """Compare designs of a sensor before it is built.

    Varies lights, crosstalk, noise and gel.

    Each design is simulated, calibrated on ball presses and measured on other presses, whose depth is known exactly. The
    slope noise and the condition number of the lights show where on the gel a design is weak, for any calibration.

    \b
    Examples:
      gelform design mine.toml -o design.png
      gelform design three-edges --json
    """
    import numpy as np

    from gelform.calibration.design import compare_designs, design_picture

    chosen = sensor_of(sensor)
    if output is not None:
        check_pictures()
        check_output(output, overwrite=overwrite)
    with shown.progress() as progress:
        results = compare_designs(chosen, presses=presses, seed=seed, progress=progress)
    if output is not None:
        from gelform.exchange.plots import save_picture

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
    shown.json({"sensor": chosen.name, "designs": rows})
    shown.table(f"Designs of {chosen.name}", DESIGN_COLUMNS, rows)
    if output is not None and not shown.as_json:
        shown.say(f"Wrote {output}.")


def demo(*, output: options.NewFolder = Path("gelform-demo"), shown: ShownOption) -> None:
    """Try everything without a sensor, on a simulated one.

    The command calibrates the sensor, reconstructs objects and compares them with the truth.

    It writes DIR/presses (a press folder), DIR/calibration.npz and DIR/report. For each of four objects (a ball, a coin-like
    relief, a screw thread, a ball cut by the border) it writes image, result and picture.

    \b
    Examples:
      gelform demo
      gelform demo -o somewhere --json
    """
    import numpy as np

    from gelform.exchange.exporters.press_folder import written_whole

    check_pictures()
    started = time.monotonic()
    with written_whole(output) as folder, shown.progress() as progress:
        simulated = simulator.simulate_ball_presses(
            simulator.LAYOUTS[LAYOUT],
            ball_diameters_mm=(6.0, 9.0),
            count=PRESSES,
            rng=np.random.default_rng(SEED),
            progress=progress,
        )
        gelform.save_simulated_presses(folder / "presses", simulated)
        presses = gelform.read_presses(folder / "presses", progress=progress)
        calibration = gelform.calibrate(presses, progress=progress)
        calibration.save(folder / "calibration.npz")
        content = content_of(presses, calibration, progress, with_learning=False)
        write_report(content, presses, calibration, folder / "report", overwrite=False)
        errors = {}
        for done, (name, press) in enumerate(_objects(simulated.sensor)):
            progress(done, 4, "reconstructing objects")
            errors[name] = _compared(folder, name, press, calibration)
            progress(done + 1, 4, "reconstructing objects")
        (folder / "errors.json").write_bytes(json_bytes(errors))
    shown.json({"folder": output, "seconds": time.monotonic() - started, "errors": errors})
    rows = [
        (name, *(form.format(row[key]).replace("%", " %") for key, (_, form) in DEMO_COLUMNS.items()))
        for name, row in errors.items()
    ]
    headings = (heading for heading, _ in DEMO_COLUMNS.values())
    shown.table("Errors against the true surfaces", ("object", *headings), rows)
    if not shown.as_json:
        shown.say(f"Wrote {output} in {time.monotonic() - started:.0f} s. Look at {output / 'coin.png'}.")


def _objects(sensor: simulator.SimulatedSensor) -> list[tuple[str, simulator.SimulatedPress]]:
    import numpy as np

    rng = np.random.default_rng(SEED + 1)
    edge = sensor.shape[1] / 2 * sensor.mm_per_px
    scenes: list[tuple[str, simulator.Indenter, float, tuple[float, float]]] = [
        ("ball", simulator.Ball(3.5), 0.7, (-1.5, 1.0)),
        ("coin", simulator.Coin(), 0.35, (0.0, 0.0)),
        ("screw", simulator.Screw(), 0.4, (0.5, -0.5)),
        ("border", simulator.Ball(3.5), 0.7, (edge - 1.0, 1.5)),
    ]
    return [
        (name, simulator.simulate_press(sensor, indenter, depth_mm=depth, center_mm=center, rng=rng))
        for name, indenter, depth, center in scenes
    ]


def _compared(
    folder: Path, name: str, press: simulator.SimulatedPress, calibration: gelform.Calibration
) -> dict[str, float]:
    """Reconstruct one object with the calibration, and compare it with the truth."""
    import numpy as np

    from gelform.exchange.plots import save_picture
    from gelform.result.metrics import angle_deg

    found = gelform.Reconstructor(calibration).from_image(press.image)
    save_picture(folder / f"{name}_image.png", press.image)
    gelform.save_result(found, folder / f"{name}.npz")
    save_picture(folder / f"{name}.png", gelform.picture(found, press.image))
    error_um = 1e3 * (found.depth_mm - press.depth_mm)
    peak = float(press.depth_mm.max())
    return {
        "true_peak_mm": peak,
        "peak_mm": found.peak_mm,
        "peak_ratio": found.peak_mm / peak,
        "rmse_um": float(np.sqrt(np.mean(error_um**2))),
        "rmse_contact_um": float(np.sqrt(np.mean(error_um[press.contact] ** 2))),
        "normal_contact_deg": float(angle_deg(found.gradients, press.gradients)[press.contact].mean()),
    }
