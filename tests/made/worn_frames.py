"""A background image with a camera's noise, and damaged frames of the same gel."""

import numpy as np

from gelform.image.frame import as_levels
from gelform.image.health import ImageBlocks, blocks_from_image

SHAPE = (96, 128)


def gel(seed: int = 0) -> np.ndarray:
    """(H, W, 3) uint8: unevenly lit, with a camera's noise."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / SHAPE[1]
    levels = np.stack([60 + 90 * x, 150 - 60 * y, 80 + 60 * (1 - x) * y], axis=-1)
    noisy = levels + np.random.default_rng(seed).normal(0, 1.5, levels.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def pressed(seed: int = 1) -> np.ndarray:
    """The gel under a ball: one side brighter, the other darker."""
    image = gel(seed).astype(np.float32)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    inside = np.hypot(x - 60, y - 45) < 20
    slope = np.stack([(x - 60) / 20, (y - 45) / 20, -(x - 60) / 20], axis=-1) * 35
    return np.clip(np.rint(image + slope * inside[..., None]), 0, 255).astype(np.uint8)


def constant(level: int | tuple[int, int, int]) -> np.ndarray:
    """A frame of one color."""
    return np.full((*SHAPE, 3), level, dtype=np.uint8)


def with_part(image: np.ndarray, part: tuple[slice, slice], level: int | tuple[int, int, int]) -> np.ndarray:
    """The image with a part of one color."""
    changed = image.copy()
    changed[part] = level
    return changed


def blocks_of(image: np.ndarray) -> ImageBlocks:
    """The image's blocks."""
    return blocks_from_image(as_levels(image))
