"""From a simulated sensor to depth in millimeters: the whole path, with only numpy and gelform.

The script presses a ball into a simulated sensor at many places, and calibrates the sensor from those images alone. Then it
presses another object in, and compares the depth with the truth.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import gelform
from gelform.simulate import LAYOUTS, Ball, simulate_ball_presses, simulate_press

rng = np.random.default_rng(0)

# 1. A sensor: three rows of near lights, 120x160 pixels, 0.127 mm each.
sensor = replace(LAYOUTS["three-edges"], shape=(120, 160), mm_per_px=0.127)

# 2. Ten minutes with two balls, in a second: background, presses, a folder as a user would have it.
simulated = simulate_ball_presses(sensor, ball_diameters_mm=[5.0, 8.0], count=16, rng=rng)
with tempfile.TemporaryDirectory() as folder:
    presses_folder = Path(folder) / "presses"
    gelform.save_simulated_presses(presses_folder, simulated, truth=False)

    # 3. Calibrate: circles are found, a color model is chosen on presses that it has not seen.
    calibration = gelform.calibrate(gelform.read_presses(presses_folder))
print("held-out errors:", {name: round(value, 2) for name, value in calibration.held_out.items()})

# 4. A new object: image -> color change -> gradients -> depth, in one call.
press = simulate_press(sensor, Ball(3.0), depth_mm=0.6, center_mm=(1.5, -1.0), rng=rng)
reconstruct = gelform.Reconstructor(calibration)
result = reconstruct(press.image)

# 5. Against the truth. Depth is positive where pressed, 0 on the untouched gel.
error_um = 1e3 * np.sqrt(np.mean((result.depth_mm - press.depth_mm) ** 2))
print(f"peak {result.depth_mm.max():.3f} mm (true {press.depth_mm.max():.3f}), RMSE {error_um:.1f} um")
assert error_um < 25
assert abs(result.depth_mm.max() / press.depth_mm.max() - 1) < 0.1
