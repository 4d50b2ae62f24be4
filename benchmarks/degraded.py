"""The effect of noise, JPEG and blur in an image: depth error in a contact and off it, with truth from the simulator.

    python benchmarks/degraded.py

Writes results/degraded.json; takes about ten seconds. The calibration is the simulated sensor's own, made from images
without compression and with that sensor's own noise.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import gelform
from gelform.calibration.library import ready_calibration
from gelform.sensors.simulated import simulated_sensor_named
from gelform.sensors.source import DEFAULT_SENSOR
from gelform.simulate import Ball, simulate_press
from report import command_line, table, write

Image = NDArray[np.uint8]
PLACES_MM = [(0.0, 0.0), (-3.0, 2.0), (3.5, -2.0), (2.0, 2.5), (-4.0, -2.5), (0.5, -3.0)]
COLUMNS = ("in_contact_um", "off_contact_um", "within_sigma_percent", "with_finding_percent")


def noisy(image: Image, sd: float) -> Image:
    """Add normal noise with a standard deviation in gray levels, the same every time."""
    noise = np.random.default_rng(5).normal(0, sd, image.shape)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


def compressed(image: Image, quality: int) -> Image:
    """Compress and decompress as JPEG of that quality."""
    _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.ascontiguousarray(cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1])


def blurred(image: Image, sd_px: float) -> Image:
    """Blur as a lens out of focus."""
    return cv2.GaussianBlur(image, (0, 0), sd_px)


CHANGES: dict[str, Callable[[Image], Image]] = {
    "as it is": lambda image: image,
    **{f"noise, sd {sd} gray levels": partial(noisy, sd=sd) for sd in (2, 5, 10)},
    **{f"JPEG, quality {quality}": partial(compressed, quality=quality) for quality in (95, 80, 50, 20)},
    **{f"blur, sd {sd} px": partial(blurred, sd_px=sd) for sd in (1, 2)},
}


def main() -> None:
    """Apply every change to every press; errors over all pixels of all presses."""
    command_line(__doc__).parse_args()
    sensor = simulated_sensor_named(DEFAULT_SENSOR)
    reconstruct = gelform.Reconstructor(ready_calibration(sensor))
    rng = np.random.default_rng(1)
    presses = [simulate_press(sensor, Ball(3.0), depth_mm=0.4, center_mm=at, rng=rng) for at in PLACES_MM]
    figures = {
        name: errors([(press, reconstruct(change(press.image))) for press in presses])
        for name, change in CHANGES.items()
    }
    print(table(("image", *COLUMNS), [(name, *map(float, one.values())) for name, one in figures.items()]))
    write("degraded", {"sensor": sensor.name, "presses": len(presses), "figures": figures})


def errors(pairs: list[tuple[Any, Any]]) -> dict[str, float]:
    """RMS error of depth, um; share of pixels within one stated sigma; share of frames with a finding."""
    inside, outside, within = [], [], []
    for press, result in pairs:
        y, x = np.mgrid[: press.depth_mm.shape[0], : press.depth_mm.shape[1]]
        distance = np.hypot(x - press.center_px[0], y - press.center_px[1])
        error = result.depth_mm - press.depth_mm
        inside.append(error[distance < press.contact_radius_px])
        outside.append(error[distance > 2 * press.contact_radius_px])
        within.append(np.mean(np.abs(error) <= result.depth_sigma_mm))
    rms = [1e3 * float(np.sqrt(np.mean(np.square(np.concatenate(part))))) for part in (inside, outside)]
    found = [bool(result.health) for _, result in pairs]
    return dict(zip(COLUMNS, (*rms, 100 * float(np.mean(within)), 100 * float(np.mean(found)))))


if __name__ == "__main__":
    main()
