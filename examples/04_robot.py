"""A robot's grip: close until the object is held, then track the markers for shear, and log depth for learning.

The frames are simulated; on a robot they come from `gelform.stream`, as in 03_stream.py. The script does not measure
force. A position-controlled gripper can stop at an indentation instead.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import gelform
from gelform.robots import depth_from_lerobot_levels, lerobot_levels_from_depth
from gelform.simulate import (
    LAYOUTS,
    Ball,
    press_poses,
    simulate_background,
    simulate_ball_presses,
    simulate_sequence,
    slide_poses,
)

# 1. A calibrated sensor whose gel has marker dots. Today's untouched image knows where they are at rest.
rng = np.random.default_rng(0)
plain = replace(LAYOUTS["three-edges"], shape=(120, 160), mm_per_px=0.127)
presses = simulate_ball_presses(plain, ball_diameters_mm=[6.0], count=10, rng=rng, oversample=1)
folder = gelform.save_simulated_presses(Path(tempfile.mkdtemp()) / "presses", presses)
calibration = gelform.calibrate(gelform.read_presses(folder), color_model="polynomial")
sensor = replace(plain, coating=replace(plain.coating, marker_pitch_mm=2.2, marker_radius_mm=0.4))
reconstruct = gelform.Reconstructor(calibration, background=simulate_background(sensor, rng))
tracker = gelform.MarkerTracker(reconstruct.markers)

# 2. Close 0.1 mm at a time; the gripper stops at 0.4 mm. Then the object is pulled to the right.
closing, pulling = press_poses(0.6, 7)[1:], slide_poses(0.4, (0.0, 0.0), (0.8, 0.0), 5)
for step, press in enumerate(simulate_sequence(sensor, Ball(5.0), closing, rng=rng)):
    result = reconstruct.from_image(press.image, markers=tracker.update(press.image))
    area_mm2 = result.contacts[0].area_mm2 if result.contacts else 0.0  # of the largest contact
    print(f"closing, step {step}: {result.peak_mm:.2f} mm deep, {area_mm2:.1f} mm2")
    if result.peak_mm >= 0.38:
        break
assert abs(result.peak_mm - press.depth_mm[result.known].max()) < 0.05  # of what no marker hides
assert abs(result.contacts[0].deepest_mm - result.peak_mm) < 0.05  # the deepest pixel may lie under a marker

levels, shear_mm = [], []
for press in simulate_sequence(sensor, Ball(5.0), pulling, rng=rng):
    result = reconstruct.from_image(press.image, markers=tracker.update(press.image))
    moved_mm = result.markers.displacement_mm[result.markers.seen]
    shear_mm.append(float(np.abs(moved_mm[:, 0]).max()))
    levels.append(lerobot_levels_from_depth(result.depth_mm))  # 16 bits: 1000 + depth in um
print("shear while pulled, mm:", [round(value, 2) for value in shear_mm])
assert shear_mm[-1] > shear_mm[0] + 0.1

# 3. What a policy is trained on loses less than a micrometer.
assert np.abs(depth_from_lerobot_levels(levels[-1]) - result.depth_mm).max() < 6e-4
