"""A bar that is longer than the sensor, pressed eight times: where it moved in between, and all presses as one surface.

python examples/08_one_surface.py
"""

import tempfile
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

import gelform
from gelform.exchange.exporters.surface import save_surface
from gelform.simulate import LAYOUTS, HeightMap, Pose, simulate_ball_presses, simulate_pose

# A sensor and its calibration, as a user makes one from presses of a ball.
rng = np.random.default_rng(0)
sensor = replace(LAYOUTS["three-edges"], shape=(120, 160), mm_per_px=0.127)
presses = simulate_ball_presses(sensor, ball_diameters_mm=[5.0, 8.0], count=12, rng=rng, oversample=1)
folder = gelform.save_simulated_presses(Path(tempfile.mkdtemp()) / "presses", presses)
calibration = gelform.calibrate(gelform.read_presses(folder), color_model="polynomial")
reconstruct = gelform.Reconstructor(calibration)

# A bar of 8 x 40 mm with bumps. A robot moves it 1.5 mm from press to press, and knows that to 0.1 mm.
STEP_MM = 1.5
y, x = (np.mgrid[:161, :801] - np.array([80, 400])[:, None, None]) * 0.05
waves = rng.uniform(0.7, 1.8, (10, 2)) * rng.choice([-1, 1], (10, 2))
bumps = sum(0.03 * np.sin(a * x + b * y + k) for k, (a, b) in enumerate(waves))
bar = HeightMap(bumps, 0.05)
places = [(STEP_MM * (k - 3.5), 0.0) for k in range(8)]
images = [simulate_pose(sensor, bar, Pose(0.45, place), rng=rng, oversample=1).image for place in places]
results = [reconstruct.from_image(image) for image in images]

# Where it moved: touch is better than the robot, and says how sure it is.
motions, errors_um = [np.eye(4)], []
for first, second in pairwise(results):
    start = np.eye(4)
    start[:2, 3] = rng.normal((STEP_MM, 0.0), 0.1)
    motion = gelform.motion_between(first, second, start=start, place_error=calibration.settings.place_error)
    assert motion.state == "found", motion.why
    errors_um.append(1e3 * np.hypot(motion.pose[0, 3] - STEP_MM, motion.pose[1, 3]))
    motions.append(motion.pose @ motions[-1])
sigma_um = 1e3 * np.sqrt(np.trace(motion.covariance[:2, :2]))
print(
    f"eight presses: each step off by {np.median(errors_um):.0f} um, stated {sigma_um:.0f} um; the robot 100 um"
)
assert np.median(errors_um) < 30

# One surface of all presses, half as long again as one.
whole = gelform.mosaic(results, motions)
save_surface(whole, "bar.ply", overwrite=True)
wide = [
    1e-2 * round(100 * np.ptp(np.nonzero(one.known & one.contact)[1]) * 0.127) for one in (results[0], whole)
]
print(f"one press shows {wide[0]:.1f} mm of the bar, all together {wide[1]:.1f} mm: bar.ply")
assert wide[1] > 1.4 * wide[0]
