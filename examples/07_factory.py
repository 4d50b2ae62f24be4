"""Inspection: is the dome on each part at least 0.30 mm high? Accept, reject, or measure again, by the stated uncertainty.

A limit is compared with the measured value and its uncertainty (the decision rule of ISO 14253-1). A value within two
standard deviations of the limit gives no decision, and neither does a frame with a finding about the sensor.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import gelform
from gelform.simulate import LAYOUTS, Ball, simulate_ball_presses, simulate_press

LIMIT_MM = 0.30
rng = np.random.default_rng(0)


def decided(result):
    """The decision, the height of the dome in mm and its standard deviation: mean of the highest 3x3 pixels."""
    if result.health:
        return f"not decided: {result.health[0].name}", 0.0, 0.0
    row, column = np.unravel_index(np.argmax(result.depth_mm), result.depth_mm.shape)
    top = slice(row - 1, row + 2), slice(column - 1, column + 2)
    height_mm, sigma_mm = float(result.depth_mm[top].mean()), float(result.depth_sigma_mm[top].mean())
    if height_mm - 2 * sigma_mm >= LIMIT_MM:
        return "accept", height_mm, sigma_mm
    return ("reject" if height_mm + 2 * sigma_mm < LIMIT_MM else "measure again"), height_mm, sigma_mm


# 1. The station's sensor, calibrated once; `gelform info cal.npz` says its errors.
sensor = replace(LAYOUTS["three-edges"], shape=(120, 160), mm_per_px=0.127)
presses = simulate_ball_presses(sensor, ball_diameters_mm=[5.0, 8.0], count=10, rng=rng, oversample=1)
folder = gelform.save_simulated_presses(Path(tempfile.mkdtemp()) / "presses", presses)
calibration = gelform.calibrate(gelform.read_presses(folder), color_model="polynomial")
reconstruct = gelform.Reconstructor(calibration)

# 2. Parts come by. The true height is known here, because they are simulated.
decisions = {}
for true_mm in (0.10, 0.20, 0.29, 0.31, 0.40, 0.50):
    press = simulate_press(sensor, Ball(4.0), depth_mm=true_mm, center_mm=(0.5, -0.5), rng=rng)
    result = reconstruct(press.image)
    decision, height_mm, sigma_mm = decided(result)
    decisions[true_mm] = decision
    print(f"true {true_mm:.2f}: {height_mm:.3f} +- {sigma_mm:.3f} mm: {decision}")
    gelform.save_result(result, f"part_{true_mm:.2f}.npz", overwrite=True)  # the whole record

# 3. Nothing good is rejected, nothing bad accepted; what is too near to the limit is said to be so.
assert all(decision != "accept" for true, decision in decisions.items() if true < LIMIT_MM)
assert all(decision != "reject" for true, decision in decisions.items() if true > LIMIT_MM)
assert decisions[0.10] == "reject"
assert decisions[0.50] == "accept"

# 4. A dead camera decides nothing.
assert decided(reconstruct(np.zeros((120, 160, 3), np.uint8)))[0].startswith("not decided")
