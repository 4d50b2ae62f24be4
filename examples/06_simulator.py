"""Training data with exact truth, from a simulator that imitates a real, calibrated sensor.

A calibration contains the forward response of its sensor (slope and place to color), and a `Twin` renders with it. Here the
imitated sensor is itself simulated, so that the copy can be compared with the original.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import gelform
from gelform.simulate import LAYOUTS, Ball, Pose, Twin, simulate_ball_presses, text_relief

# 1. A sensor on the desk, and its calibration.
rng = np.random.default_rng(0)
sensor = replace(LAYOUTS["three-edges"], shape=(120, 160), mm_per_px=0.127)
presses = simulate_ball_presses(sensor, ball_diameters_mm=[5.0, 8.0], count=10, rng=rng, oversample=1)
folder = gelform.save_simulated_presses(Path(tempfile.mkdtemp()) / "presses", presses)
calibration = gelform.calibrate(gelform.read_presses(folder), color_model="polynomial")

# 2. Its twin shows what the sensor would show: the same surface in both, and how far the colors are apart.
twin = Twin(calibration, gel=sensor.gel, relaxation_mm=sensor.relaxation_mm)
original = presses.presses[3]
copy = twin.rendered(original, rng)
apart = copy.image.astype(float) - original.image
print(f"twin against sensor: {np.sqrt(np.mean(apart**2)):.1f} gray levels RMS")
assert np.sqrt(np.mean(apart**2)) < 8

# 3. A data set: objects that nobody has to press, anywhere, as deep as one likes. Truth is exact for every pixel.
images, depths_mm = [], []
for indenter in (Ball(3.0), text_relief("GEL", height_mm=5.0)):
    for x_mm in (-2.0, 2.0):
        press = twin.press(indenter, Pose(depth_mm=0.4, center_mm=(x_mm, 0.0)), rng=rng)
        images.append(press.image)
        depths_mm.append(press.depth_mm)
np.savez_compressed("set.npz", image=np.stack(images), depth_mm=np.stack(depths_mm))
print("set.npz:", np.stack(images).shape, "images with depth, mm")

# 4. The set is of this sensor: its own calibration reads the balls back.
reconstruct = gelform.Reconstructor(calibration)
for image, depth_mm in zip(images[:2], depths_mm):
    error_um = 1e3 * np.sqrt(np.mean((reconstruct.from_image(image).depth_mm - depth_mm) ** 2))
    print(f"read back: {error_um:.1f} um RMS of {1e3 * depth_mm.max():.0f} um")
    assert error_um < 25
