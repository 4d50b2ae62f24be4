"""gelform demo: the whole path on a simulated sensor, compared with the truth."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import gelform
from gelform import simulate
from gelform.cli import options
from gelform.cli.console import ShownOption, check_pictures, json_bytes
from gelform.cli.files import content_of, write_report

LAYOUT, PRESSES, SEED = "three-edges", 24, 7
COLUMNS = {  # of the table: heading and format of each error
    "true_peak_mm": ("true peak (mm)", "{:.3f}"),
    "peak_mm": ("peak (mm)", "{:.3f}"),
    "peak_ratio": ("ratio", "{:.1%}"),
    "rmse_um": ("depth RMSE (um)", "{:.1f}"),
    "rmse_contact_um": ("RMSE in contact (um)", "{:.1f}"),
    "normal_contact_deg": ("normals (°)", "{:.1f}"),
}


def demo(
    *,
    output: Annotated[Path, options.output("DIR", "A new or empty folder for the files.")] = Path(
        "gelform-demo"
    ),
    shown: ShownOption,
) -> None:
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
        simulated = simulate.simulate_ball_presses(
            simulate.LAYOUTS[LAYOUT],
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
        (name, *(form.format(row[key]).replace("%", " %") for key, (_, form) in COLUMNS.items()))
        for name, row in errors.items()
    ]
    headings = (heading for heading, _ in COLUMNS.values())
    shown.table("Errors against the true surfaces", ("object", *headings), rows)
    if not shown.as_json:
        shown.say(f"Wrote {output} in {time.monotonic() - started:.0f} s. Look at {output / 'coin.png'}.")


def _objects(sensor: simulate.SimulatedSensor) -> list[tuple[str, simulate.SimulatedPress]]:
    import numpy as np

    rng = np.random.default_rng(SEED + 1)
    edge = sensor.shape[1] / 2 * sensor.mm_per_px
    scenes: list[tuple[str, simulate.Indenter, float, tuple[float, float]]] = [
        ("ball", simulate.Ball(3.5), 0.7, (-1.5, 1.0)),
        ("coin", simulate.Coin(), 0.35, (0.0, 0.0)),
        ("screw", simulate.Screw(), 0.4, (0.5, -0.5)),
        ("border", simulate.Ball(3.5), 0.7, (edge - 1.0, 1.5)),
    ]
    return [
        (name, simulate.simulate_press(sensor, indenter, depth_mm=depth, center_mm=center, rng=rng))
        for name, indenter, depth, center in scenes
    ]


def _compared(
    folder: Path, name: str, press: simulate.SimulatedPress, calibration: gelform.Calibration
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
