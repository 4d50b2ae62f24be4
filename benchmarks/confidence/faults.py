"""Random faults in an image, of realistic size, for tests and benchmarks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import gelform

Image = NDArray[np.uint8]
Fault = Callable[[Image, np.random.Generator], Image]


def region(
    shape: tuple[int, int], rng: np.random.Generator, size: tuple[float, float]
) -> NDArray[np.float32]:
    """An ellipse, 0-1, of random place and direction; axes of `size` as fractions of the height, rim blurred by 1.5 px."""
    height, width = shape
    center = rng.uniform(0.1, 0.9, 2) * (width, height)
    axes = rng.uniform(*size, 2) * height / 2
    mask = np.zeros(shape, np.uint8)
    ellipse = tuple(center.tolist()), tuple((2 * axes).tolist()), float(rng.uniform(0, 180))
    cv2.ellipse(mask, ellipse, 1, -1)
    return cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 1.5)


def _towards(image: Image, there: NDArray[np.float32], wanted: NDArray[Any]) -> Image:
    mixed = image + there[..., None] * (wanted - image)
    return np.clip(np.rint(mixed), 0, 255).astype(np.uint8)


def saturated(image: Image, rng: np.random.Generator) -> Image:
    """A spot at the camera's upper end."""
    return _towards(image, region(image.shape[:2], rng, (0.03, 0.15)), np.full(3, 300.0))


def dark(image: Image, rng: np.random.Generator) -> Image:
    """A spot at the camera's lower end."""
    return _towards(image, region(image.shape[:2], rng, (0.03, 0.15)), np.full(3, -40.0))


def shadow(image: Image, rng: np.random.Generator) -> Image:
    """A spot that loses 40 to 65 % of all lights."""
    left = rng.uniform(0.35, 0.6)
    return _towards(image, region(image.shape[:2], rng, (0.05, 0.25)), image * left)


def specular(image: Image, rng: np.random.Generator) -> Image:
    """A spot that gains 60 to 110 % of all lights, within the camera's range."""
    gain = rng.uniform(1.6, 2.1)
    bright = np.minimum(image * gain, 250.0)
    return _towards(image, region(image.shape[:2], rng, (0.04, 0.12)), bright)


def dirt(image: Image, rng: np.random.Generator) -> Image:
    """A spot of another color: one channel gains, the others lose."""
    factor = rng.permutation([rng.uniform(1.6, 2.2), rng.uniform(0.2, 0.5), rng.uniform(0.2, 0.5)])
    return _towards(image, region(image.shape[:2], rng, (0.05, 0.15)), np.minimum(image * factor, 250.0))


def torn(image: Image, rng: np.random.Generator) -> Image:
    """The frame gray below a random row, as after a decoder's failure."""
    changed = image.copy()
    changed[int(rng.uniform(0.3, 0.9) * len(image)) :] = 128
    return changed


def compressed(image: Image, rng: np.random.Generator) -> Image:
    """JPEG of quality 5 to 20."""
    quality = int(rng.integers(5, 21))
    _, data = cv2.imencode(
        ".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality]
    )
    return np.ascontiguousarray(cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1])


FAULTS: dict[str, Fault] = {
    "saturated": saturated,
    "dark": dark,
    "shadow": shadow,
    "specular": specular,
    "off_gamut": dirt,
    "inconsistent": torn,
    "compression": compressed,
}
"""One fault per cause that a single frame can show."""


def dots(shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float32]:
    """A lattice of printed dots, 0-1: the fraction of light that they absorb."""
    pitch, radius = rng.uniform(18, 30), rng.uniform(2.5, 4)
    y, x = np.mgrid[: shape[0], : shape[1]]
    off = rng.uniform(0, pitch, 2)
    away = np.hypot((x - off[0]) % pitch - pitch / 2, (y - off[1]) % pitch - pitch / 2)
    return cv2.GaussianBlur((away < radius).astype(np.float32), (0, 0), 0.8)


def printed(
    calibration: gelform.Calibration, image: Image, name: str, rng: np.random.Generator
) -> tuple[gelform.Calibration, Image]:
    """Background and image with faults of the gel itself: `marker` dots, or a corner `outside` the light."""
    shape = calibration.image_shape
    if name == "marker":
        left = 1 - 0.8 * dots(shape, rng)
    else:
        size = int(rng.uniform(0.08, 0.25) * shape[0])
        left = np.ones(shape, np.float32)
        left[:size, :size] = 0.02
        left = np.rot90(left, 2) if rng.random() < 0.5 else left
    background = (calibration.background * left[..., None]).astype(np.float32)
    return replace(calibration, background=background), np.rint(image * left[..., None]).astype(np.uint8)


def corrupted(image: Image, rng: np.random.Generator, fraction: float) -> tuple[Image, NDArray[np.bool_]]:
    """An image in which saturated, dark, shadowed, specular and dirty spots spoil a fraction of the pixels."""
    changed = image
    while True:
        fault = rng.choice(["saturated", "dark", "shadow", "specular", "off_gamut"])
        changed = FAULTS[str(fault)](changed, rng)
        spoilt = np.abs(changed.astype(int) - image).max(axis=-1) > 8
        if spoilt.mean() >= fraction:
            return changed, spoilt
