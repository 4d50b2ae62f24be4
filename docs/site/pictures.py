"""The pictures of docs/from-color-to-depth.md, on surfaces whose depth is known.

python docs/site/pictures.py docs/images
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import gelform
from gelform.simulate import LAYOUTS, Ball, simulate_background, simulate_press

PITCH = 0.05  # mm per pixel
ANGLES = np.radians([0, 120, 240])
LIGHTS = np.stack([0.6 * np.cos(ANGLES), 0.6 * np.sin(ANGLES), np.full(3, 0.8)], axis=-1)


def bump() -> tuple[Any, Any]:
    """Depth (mm) of a smooth bump and a groove, and its exact slopes."""
    y, x = np.mgrid[:120, :160].astype(float)
    x, y = (x - 80) * PITCH, (y - 60) * PITCH
    depth = 0.4 * np.exp(-(x**2 + y**2) / 2)
    return depth, np.stack([-x * depth, -y * depth], axis=-1)


def shown(axis: Any, values: Any, title: str, **how: Any) -> None:
    """One panel without ticks."""
    axis.imshow(values, **how)
    axis.set_title(title, fontsize=9)
    axis.set_xticks([])
    axis.set_yticks([])


def panels(count: int) -> tuple[Any, Any]:
    """A figure with a row of panels."""
    return plt.subplots(1, count, figsize=(2.1 * count, 1.95), layout="constrained")


def three_lights() -> Any:
    """What each of three lights shows of the bump, the three as one image, and the normals found from it."""
    _, gradients = bump()
    image = gelform.image_from_normals(gelform.normals_from_gradients(gradients), LIGHTS, albedo=180.0)
    normals, _ = gelform.normals_from_image(image, LIGHTS)
    figure, axes = panels(5)
    for k, name in enumerate(("red: from the right", "green: from below left", "blue: from above left")):
        shown(axes[k], image[..., k], name, cmap="gray", vmin=60, vmax=180)
    shown(axes[3], image / 190, "the three as one image")
    shown(axes[4], (normals + 1) / 2, "normals found")
    return figure


def two_ways() -> Any:
    """Depth by going right then down, by going down then right, and how far the two are apart."""
    rng = np.random.default_rng(0)
    _, gradients = bump()
    noisy = gradients + rng.normal(0, 0.05, gradients.shape)
    figure, axes = panels(4)
    for k, (name, slopes) in enumerate((("exact slopes", gradients), ("noise of 0.05", noisy))):
        first, second = right_then_down(slopes), right_then_down(slopes.swapaxes(0, 1)[..., ::-1]).T
        shown(axes[2 * k], first, name, cmap="viridis")
        apart = 1e3 * (first - second)
        title = f"ways apart: {np.sqrt(np.mean(apart**2)):.2g} um"
        shown(axes[2 * k + 1], apart, title, cmap="RdBu_r", vmin=-100, vmax=100)
    return figure


def right_then_down(gradients: Any) -> Any:
    """Depth (mm) summed along the first row, then down each column (trapezoid rule)."""
    across, down = gradients[..., 0], gradients[..., 1]
    top = np.concatenate([[0], np.cumsum((across[0, 1:] + across[0, :-1]) / 2)])
    steps = np.cumsum((down[1:] + down[:-1]) / 2, axis=0)
    return PITCH * (top + np.concatenate([np.zeros_like(top)[None], steps]))


def least_squares() -> Any:
    """Errors of both ways and of least squares, from the same noisy slopes."""
    depth, gradients = bump()
    noisy = gradients + np.random.default_rng(0).normal(0, 0.05, gradients.shape)
    found = {
        "right, then down": right_then_down(noisy),
        "down, then right": right_then_down(noisy.swapaxes(0, 1)[..., ::-1]).T,
        "least squares": gelform.depth_from_gradients(noisy, mm_per_px=PITCH),
    }
    figure, axes = panels(3)
    for axis, (name, values) in zip(axes, found.items()):
        error = 1e3 * (values - depth - np.mean(values - depth))
        title = f"{name}: {np.sqrt(np.mean(error**2)):.2g} um"
        shown(axis, error, title, cmap="RdBu_r", vmin=-100, vmax=100)
    return figure


def calibration() -> Any:
    """Color change by slope at two places of a simulated sensor with near lights, beside the ideal model's."""
    rng = np.random.default_rng(0)
    sensor = replace(LAYOUTS["three-edges"], shape=(120, 160), mm_per_px=0.127)
    background = simulate_background(sensor, rng).astype(np.float32)
    figure, axes = plt.subplots(1, 3, figsize=(9, 2.6), layout="constrained", width_ratios=(1, 1.2, 1.2))
    for axis, x_mm, title in ((axes[1], -5.0, "pressed at the left"), (axes[2], 5.0, "pressed at the right")):
        press = simulate_press(sensor, Ball(4.0), depth_mm=0.5, center_mm=(x_mm, 0.0), rng=rng)
        change = gelform.color_change_from_image(press.image, background)
        near = press.contact & (np.abs(press.gradients[..., 1]) < 0.05)
        for k, color in enumerate(("tab:red", "tab:green", "tab:blue")):
            axis.plot(press.gradients[near, 0], change[near, k], ".", color=color, markersize=3)
        axis.set(title=title, xlabel="slope dz/dx", ylim=(-0.6, 0.6))
        axis.title.set_size(9)
    axes[1].set_ylabel("color change")
    shown(axes[0], press.image, "a press of a ball")
    return figure


PICTURES = {
    "theory-lights": three_lights,
    "theory-two-ways": two_ways,
    "theory-least-squares": least_squares,
    "theory-calibration": calibration,
}


def draw(folder: Path) -> None:
    """All pictures, as PNG files of a folder."""
    for name, make in PICTURES.items():
        figure = make()
        figure.savefig(folder / f"{name}.png", dpi=100, metadata={"Software": None})
        plt.close(figure)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
