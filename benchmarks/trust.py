"""Whether repeated frames pass for presses, and what a second unit needs.

    python benchmarks/trust.py                    # about 5 minutes; writes results/trust.json
    python benchmarks/trust.py second_unit

`repeated` reads real presses (mini-ball below GELFORM_DATA, default ../shared/data), and is left out without them. Every
judged press is new to the calibration. Coverage of sigma, and few presses, are in accuracy.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

import gelform
from gelform.calibration.report import report_content
from gelform.simulate import LAYOUTS, SimulatedSensor, simulate_ball_presses
from presses import data_is_missing, mini_ball, presses_of, unlabeled
from report import command_line, parts_asked, recorded, table, write


def repeated() -> dict[str, Any]:
    """Five presses, and six frames of each: verdict, held-out error, and error on the other presses."""
    presses, order = mini_ball()
    figures: dict[str, Any] = {}
    for seed in range(3):
        rng = np.random.default_rng(seed)
        training = [int(i) for i in rng.permutation(order)[:5]]
        alone = unlabeled(presses, training)
        frames = tuple(_frame(press, rng) for press in alone.presses for _ in range(6))
        test = presses.subset([i for i in order if i not in training][::3])
        for name, some in (("5 presses", alone), ("30 frames of them", replace(alone, presses=frames))):
            calibration = gelform.calibrate(some, start=None)  # the starter has seen these presses
            verdict = report_content(some, calibration, rng=rng)["verdict"]["headline"]
            errors = [calibration.held_out, gelform.evaluate(calibration, test).summary]
            found = [errors_of["normal_free_deg"] for errors_of in errors]
            figures[f"{seed}: {name}"] = {
                "verdict": verdict,
                "held_out_deg": found[0],
                "others_deg": found[1],
            }
            print(f"{seed}: {name}: held out {found[0]:.2f}, others {found[1]:.2f} degrees. {verdict}")
    return figures


def _frame(press: Any, rng: np.random.Generator) -> Any:
    """Another frame of a press that is held: moved by up to half a pixel, with camera noise."""
    height, width = press.image.shape[:2]
    move = np.array([[1, 0, rng.uniform(-0.5, 0.5)], [0, 1, rng.uniform(-0.5, 0.5)]])
    image = cv2.warpAffine(
        press.image.astype(np.float32), move, (width, height), borderMode=cv2.BORDER_REFLECT
    )
    image = np.clip(np.rint(image + rng.normal(0, 1.5, image.shape)), 0, 255).astype(np.uint8)
    return replace(press, image=image)


def second_unit() -> dict[str, Any]:
    """Another unit of a simulated sensor, with LEDs displaced by 2 mm (sd) and up to 30 % brighter or dimmer."""
    first = replace(LAYOUTS["three-edges"], shape=(132, 176), mm_per_px=0.1153)
    figures: dict[str, Any] = {}
    for seed in (5, 6, 7):
        rng = np.random.default_rng(seed)
        leds = tuple(
            replace(
                led,
                position_mm=tuple(np.array(led.position_mm) + rng.normal(0, 2, 3) * (1, 1, 0.5)),
                color=tuple(np.array(led.color) * rng.uniform(0.7, 1.3)),
            )
            for led in first.leds
        )
        unit = replace(first, leds=leds, name="second unit")
        taught = gelform.calibrate(_presses(first, 30, 1), color_model="hierarchical")
        many, five, test = (_presses(unit, n, seed + s) for n, s in ((30, 10), (5, 20), (12, 30)))
        calibrations = {
            "its own 30 presses": gelform.calibrate(many, color_model="hierarchical"),
            "the first unit's, as it is": replace(taught, background=test.background),
            "the first unit's and 5 presses": gelform.calibrate(five, start=taught),
            "5 presses alone": gelform.calibrate(five, color_model="hierarchical"),
        }
        figures[str(seed)] = {
            name: gelform.evaluate(calibration, test).summary for name, calibration in calibrations.items()
        }
        keys = ("normal_free_deg", "cap_free_um", "radius_percent")
        rows = [[name, *(row[key] for key in keys)] for name, row in figures[str(seed)].items()]
        print("\n" + table([f"second unit {seed}", *keys], rows))
    return figures


def _presses(sensor: SimulatedSensor, count: int, seed: int) -> Any:
    made = simulate_ball_presses(
        sensor, ball_diameters_mm=[5.0, 8.0], count=count, rng=np.random.default_rng(seed)
    )
    return presses_of(made)


PARTS: dict[str, Callable[[], dict[str, Any]]] = {"repeated": repeated, "second_unit": second_unit}


def main() -> None:
    """Run the named parts, or all; keep the earlier figures of the others."""
    asked = parts_asked(command_line(__doc__), PARTS)
    figures = recorded("trust")
    for name in asked.parts:
        if name != "second_unit" and data_is_missing(name):
            continue
        figures[name] = PARTS[name]()
        write("trust", figures)


if __name__ == "__main__":
    main()
