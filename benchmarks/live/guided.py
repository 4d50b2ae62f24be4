"""The guided calibration in a browser, compared with one made offline from as many presses of the same ball."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

import gelform
from gelform.calibration.fit import evaluate
from gelform.calibration.presses.press_set import presses_from_simulated
from gelform.sensors.simulated import simulated_sensor_named
from gelform.sensors.source import DEFAULT_SENSOR
from gelform.simulate import simulate_ball_presses

BALL_MM, WANTED = 5.0, 12
UNSEEN, SEED_OFFLINE, SEED_UNSEEN = 12, 41, 42
LONGEST_S = 300.0
NORMAL = "normal_free_deg"


def guided(page: Any, folder: Path, wanted: int = WANTED) -> dict[str, Any]:
    """Press Start, wait for the presses, fit, use: seconds of each part, and the error on presses that are new to both.

    Parameters
    ----------
    page : Playwright's, on a server whose `--folder` is `folder` and whose sensor is the simulated one
    folder : folder of the calibration
    wanted : number of presses before the fit
    """
    page.click("#tab-calibrate")
    page.fill("#ball", str(BALL_MM))
    began = time.monotonic()
    page.click("#guide-start")
    wait_for(page, f"gelform.facts.guides[0]?.count >= {wanted}")
    pressed = time.monotonic()
    page.click("#guide-fit")
    wait_for(page, "gelform.facts.guides[0]?.step === 'report'")
    count = page.evaluate("gelform.facts.guides[0].count")
    fitted = time.monotonic()
    page.click("#guide-use")
    wait_for(
        page, "!gelform.facts.guides[0] && gelform.facts.stations[0].calibration.includes('calibration')"
    )
    used = time.monotonic()
    path = next(folder.glob("calibration-*/calibration.npz"))
    return {
        "presses": count,
        "pressing_s": pressed - began,
        "fit_s": fitted - pressed,
        "total_s": used - began,
        **_errors(gelform.load_calibration(path), count),
    }


def _errors(calibration: gelform.Calibration, count: int) -> dict[str, float]:
    """Errors of normals, degrees: on each calibration's own held-out presses, and on presses that are new to both."""
    sensor = simulated_sensor_named(DEFAULT_SENSOR)

    def presses(number: int, seed: int) -> Any:
        rng = np.random.default_rng(seed)
        return presses_from_simulated(
            simulate_ball_presses(sensor, ball_diameters_mm=[BALL_MM], count=number, rng=rng, oversample=1)
        )

    offline, unseen = gelform.calibrate(presses(count, SEED_OFFLINE)), presses(UNSEEN, SEED_UNSEEN)
    on_unseen = [evaluate(one, unseen).summary[NORMAL] for one in (calibration, offline)]
    held_out = [one.held_out[NORMAL] for one in (calibration, offline)]
    return {
        "held_out_deg": held_out[0],
        "held_out_offline_deg": held_out[1],
        "held_out_ratio": held_out[0] / held_out[1],
        "unseen_deg": on_unseen[0],
        "unseen_offline_deg": on_unseen[1],
        "unseen_ratio": on_unseen[0] / on_unseen[1],
    }


def wait_for(page: Any, condition: str) -> None:
    """Wait in Python: the page's policy forbids Playwright's own waiting for a script, which evaluates text."""
    stop = time.monotonic() + LONGEST_S
    while not page.evaluate(f"Boolean({condition})"):
        if time.monotonic() > stop:
            raise TimeoutError(f"Expected {condition} within {LONGEST_S:g} s.")
        page.wait_for_timeout(100)
