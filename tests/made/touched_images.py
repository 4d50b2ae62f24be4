"""A background and an image with a contact."""

import numpy as np

SHAPE = (60, 80)


def scene(seed: int = 0) -> np.ndarray:
    """A smooth, unevenly lit background with noise, channels clearly different."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 80
    levels = np.stack([60 + 90 * x, 110 - 40 * y, 80 + 60 * (1 - x) * y], axis=-1)
    return (levels + np.random.default_rng(seed).normal(0, 1, levels.shape)).astype(np.float32)


def touched(background: np.ndarray) -> np.ndarray:
    image = background.copy()
    image[20:40, 30:50] += np.array([40, -30, 20], dtype=np.float32)
    return np.clip(image, 0, 255)
