"""Faults of a simulated sensor, of random realistic sizes, and sequences with one of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.calibration_file import Calibration
from gelform.reconstruct import Reconstructor
from gelform.sensors.streams.memory import Memory
from gelform.simulate import SimulatedSensor, simulate_background
from gelform.simulate.sensor import Coating

Image = NDArray[np.float64]
ONSET_S, RATE_HZ = 12.0, 1.0
BACKGROUND_FRAMES = 10


@dataclass(frozen=True, eq=False)
class Gel:
    """A sensor with a gel of its own texture: images without noise, and with noise."""

    sensor: SimulatedSensor
    rest: Image

    @classmethod
    def drawn(cls, sensor: SimulatedSensor, rng: np.random.Generator) -> Gel:
        """A random coating: rough, with some dust and scratches from the start."""
        coating = Coating(
            roughness=float(rng.uniform(0.003, 0.01)),
            scratches=int(rng.integers(0, 4)),
            dust=int(rng.integers(0, 6)),
            seed=int(rng.integers(1 << 30)),
        )
        textured = replace(sensor, coating=coating)
        return cls(textured, np.asarray(simulate_background(textured, None, quantise=False)))

    def frame(self, image: Image, rng: np.random.Generator) -> NDArray[np.uint8]:
        """The frame of the camera: with the sensor's noise, in whole levels."""
        sd = np.sqrt(self.sensor.noise_sd**2 + self.sensor.noise_gain * np.maximum(image, 0))
        return np.clip(np.rint(image + sd * rng.normal(size=image.shape)), 0, 255).astype(np.uint8)

    def calibration(self, calibration: Calibration, rng: np.random.Generator) -> Calibration:
        """The calibration with this gel's background image, the mean of ten frames."""
        frames = [self.frame(self.rest, rng) for _ in range(BACKGROUND_FRAMES)]
        return replace(calibration, background=np.mean(frames, axis=0).astype(np.float32))


def brightness(image: Image, rng: np.random.Generator) -> Image:
    """Change of exposure or of all LEDs by 10-25 %."""
    return image * (1 + rng.choice([-1, 1]) * rng.uniform(0.10, 0.25))


def color(image: Image, rng: np.random.Generator) -> Image:
    """Change of the white balance, or aging of one LED: one channel by 5-15 %."""
    gains = np.ones(3)
    gains[rng.integers(3)] += rng.choice([-1, 1]) * rng.uniform(0.05, 0.15)
    return image * gains


def moved(image: Image, rng: np.random.Generator) -> Image:
    """A shift of the camera in its mount by 1-4 px, and up to 0.3 degrees."""
    height, width = image.shape[:2]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), float(rng.uniform(-0.3, 0.3)), 1)
    angle, length = rng.uniform(0, 2 * np.pi), rng.uniform(1, 4)
    turn[:, 2] += length * np.cos(angle), length * np.sin(angle)
    return cv2.warpAffine(image, turn, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


def scratch(image: Image, rng: np.random.Generator) -> Image:
    """A groove of 15-60 px: bright on one side, dark on the other, differently in each channel."""
    height, width = image.shape[:2]
    length, angle = rng.uniform(15, 60), rng.uniform(0, np.pi)
    x0, y0 = rng.uniform(0.25, 0.75, 2) * (width, height)
    y, x = np.mgrid[:height, :width]
    along = (x - x0) * np.cos(angle) + (y - y0) * np.sin(angle)
    across = -(x - x0) * np.sin(angle) + (y - y0) * np.cos(angle)
    half = rng.uniform(0.8, 1.6)
    groove = across / half * np.exp(0.5 - across**2 / (2 * half**2)) * (np.abs(along) < length / 2)
    strength = rng.choice([-1, 1], 3) * rng.uniform(0.15, 0.4, 3)
    return image * (1 + groove[..., None] * strength)


def dust(image: Image, rng: np.random.Generator) -> Image:
    """A dark spot, 3-8 px wide."""
    height, width = image.shape[:2]
    x0, y0 = rng.uniform(0.1, 0.9, 2) * (width, height)
    y, x = np.mgrid[:height, :width]
    inside = 1 / (1 + np.exp((np.hypot(x - x0, y - y0) - rng.uniform(1.5, 4)) / 0.4))
    return image * (1 - rng.uniform(0.3, 0.7) * inside[..., None])


def tear(image: Image, rng: np.random.Generator) -> Image:
    """Loss of the coating on 0.5-5 % of the image: darker or brighter by at least a third in all channels."""
    height, width = image.shape[:2]
    radius = np.sqrt(rng.uniform(0.005, 0.05) * height * width / np.pi)
    x0, y0 = rng.uniform(0.15, 0.85, 2) * (width, height)
    y, x = np.mgrid[:height, :width]
    angle = np.arctan2(y - y0, x - x0)
    ragged = 1 + 0.25 * np.sin(3 * angle + rng.uniform(0, 6)) + 0.15 * np.sin(5 * angle + rng.uniform(0, 6))
    gone = np.hypot(x - x0, y - y0) < radius * ragged
    factor = rng.uniform(0.3, 0.65) if rng.random() < 0.5 else rng.uniform(1.35, 1.8)
    return image * np.where(gone[..., None], factor, 1)


def room_light(image: Image, rng: np.random.Generator) -> Image:
    """Light through the gel's edge: 6-25 gray levels in all channels, slightly colored, stronger on one side."""
    height, width = image.shape[:2]
    y, x = np.mgrid[:height, :width]
    angle = rng.uniform(0, 2 * np.pi)
    side = np.cos(angle) * (x / width - 0.5) + np.sin(angle) * (y / height - 0.5)
    tint = rng.uniform(0.85, 1.15, 3)
    return image + rng.uniform(6, 25) * (1 + rng.uniform(0, 0.4) * side[..., None]) * tint


CHANGES: dict[str, Callable[[Image, np.random.Generator], Image]] = {
    "brightness_shift": brightness,
    "color_shift": color,
    "camera_moved": moved,
    "scratch": scratch,
    "dust": dust,
    "tear": tear,
    "room_light": room_light,
}
FAULTS = (*CHANGES, "other_gel", "frozen", "torn")


def frames_with(
    fault: str | None, gel: Gel, seconds: float, rng: np.random.Generator
) -> Iterator[NDArray[np.uint8]]:
    """Frames of the untouched gel, one a second, with the fault from the twelfth second on; `other_gel` from the first."""
    if fault == "other_gel":
        gel = Gel.drawn(gel.sensor, rng)
    changed = CHANGES[fault](gel.rest, rng) if fault in CHANGES else gel.rest
    last, part = None, float(rng.uniform(0.2, 0.9))
    for index in range(round(seconds * RATE_HZ)):
        begun = index / RATE_HZ >= ONSET_S
        frame = gel.frame(changed if begun else gel.rest, rng)
        if fault == "torn" and begun:
            frame[int(part * frame.shape[0]) :] = 128
        if fault == "frozen" and begun and last is not None:
            frame = last
        last = frame
        yield frame


def found_in(
    frames: Iterator[NDArray[np.uint8]], calibration: Calibration, rate_hz: float = RATE_HZ
) -> dict[str, float]:
    """The names of all findings of a stream of these frames, and when each came first, s."""
    memory = Memory(Reconstructor(calibration))
    first: dict[str, float] = {}
    for index, image in enumerate(frames):
        time_s = index / rate_hz
        result = replace(memory.result_from_image(image), index=index, time_s=time_s)
        for finding in memory(image, result).health:
            first.setdefault(finding.name, time_s)
    return first
