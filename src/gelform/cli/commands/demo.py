"""gelform demo: the whole path on a simulated sensor, compared with the truth."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from gelform.cli.console import check_pictures, json_bytes
from gelform.cli.options import ShownOption
from gelform.foundations.findings import Progress

if TYPE_CHECKING:
    from gelform.calibration_file import Calibration
    from gelform.simulate import SimulatedPress, SimulatedSensor

LAYOUT, PRESSES, BALLS_MM, SEED = "three-edges", 24, (6.0, 9.0), 7


def demo(
    *,
    output: Annotated[
        Path, Option("--output", "-o", metavar="DIR", help="A new or empty folder for the files.")
    ] = Path("gelform-demo"),
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
    from gelform.exchange.exporters.press_folder import written_whole

    check_pictures()
    started = time.monotonic()
    with written_whole(output) as folder, shown.progress() as progress:
        sensor = _simulated(folder / "presses", progress)
        calibration = _calibrated(folder, progress)
        errors = {}
        for done, (name, press) in enumerate(_objects(sensor)):
            progress(done, 4, "reconstructing objects")
            errors[name] = _compared(folder, name, press, calibration)
            progress(done + 1, 4, "reconstructing objects")
        (folder / "errors.json").write_bytes(json_bytes(errors))
    shown.json({"folder": output, "seconds": time.monotonic() - started, "errors": errors})
    rows = [(name, *(_shown(key, value) for key, value in row.items())) for name, row in errors.items()]
    shown.table(
        "Errors against the true surfaces",
        (
            "object",
            "true peak (mm)",
            "peak (mm)",
            "ratio",
            "depth RMSE (um)",
            "RMSE in contact (um)",
            "normals (°)",
        ),
        rows,
    )
    if not shown.as_json:
        shown.say(f"Wrote {output} in {time.monotonic() - started:.0f} s. Look at {output / 'coin.png'}.")


def _simulated(folder: Path, progress: Progress) -> SimulatedSensor:
    import numpy as np

    from gelform.exchange.exporters.press_folder import save_simulated_presses
    from gelform.simulate import LAYOUTS, simulate_ball_presses

    presses = simulate_ball_presses(
        LAYOUTS[LAYOUT],
        ball_diameters_mm=BALLS_MM,
        count=PRESSES,
        rng=np.random.default_rng(SEED),
        progress=progress,
    )
    save_simulated_presses(folder, presses)
    return presses.sensor


def _calibrated(folder: Path, progress: Progress) -> Calibration:
    from gelform.calibration.fit import calibrate
    from gelform.calibration.presses.folder import read_presses
    from gelform.cli.files import content_of, write_report

    presses = read_presses(folder / "presses", progress=progress)
    calibration = calibrate(presses, progress=progress)
    calibration.save(folder / "calibration.npz")
    content = content_of(presses, calibration, progress, with_learning=False)
    write_report(content, presses, calibration, folder / "report", overwrite=False)
    return calibration


def _objects(sensor: SimulatedSensor) -> list[tuple[str, SimulatedPress]]:
    import numpy as np

    from gelform.simulate import Ball, Coin, Screw, simulate_press

    rng = np.random.default_rng(SEED + 1)
    edge = sensor.shape[1] / 2 * sensor.mm_per_px
    scenes: list[tuple[str, Any, float, tuple[float, float]]] = [
        ("ball", Ball(3.5), 0.7, (-1.5, 1.0)),
        ("coin", Coin(), 0.35, (0.0, 0.0)),
        ("screw", Screw(), 0.4, (0.5, -0.5)),
        ("border", Ball(3.5), 0.7, (edge - 1.0, 1.5)),
    ]
    return [
        (name, simulate_press(sensor, indenter, depth_mm=depth, center_mm=center, rng=rng))
        for name, indenter, depth, center in scenes
    ]


def _compared(folder: Path, name: str, press: SimulatedPress, calibration: Calibration) -> dict[str, float]:
    """Reconstruct one object with the calibration, and compare it with the truth."""
    import numpy as np

    from gelform.exchange.plots import picture, save_picture
    from gelform.reconstruct import Reconstructor
    from gelform.result import save_result
    from gelform.result.metrics import angle_deg

    result = Reconstructor(calibration).from_image(press.image)
    save_picture(folder / f"{name}_image.png", press.image)
    save_result(result, folder / f"{name}.npz")
    save_picture(folder / f"{name}.png", picture(result, press.image))
    error_um = 1e3 * (result.depth_mm - press.depth_mm)
    peak = float(press.depth_mm.max())
    return {
        "true_peak_mm": peak,
        "peak_mm": result.peak_mm,
        "peak_ratio": result.peak_mm / peak,
        "rmse_um": float(np.sqrt(np.mean(error_um**2))),
        "rmse_contact_um": float(np.sqrt(np.mean(error_um[press.contact] ** 2))),
        "normal_contact_deg": float(angle_deg(result.gradients, press.gradients)[press.contact].mean()),
    }


def _shown(key: str, value: float) -> str:
    return (
        f"{100 * value:.1f} %"
        if key == "peak_ratio"
        else f"{value:.3f}"
        if key.endswith("_mm")
        else f"{value:.1f}"
    )
