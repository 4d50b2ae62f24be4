"""Images of dark dots at known places, with uneven light and noise."""

import numpy as np

SHAPE = (96, 128)
RADIUS = 3.0


def grid(pitch=16.0, shape=SHAPE, margin=10.0):
    """Places (N, 2), x and y, of a square grid."""
    y, x = np.mgrid[margin : shape[0] - margin + 1 : pitch, margin : shape[1] - margin + 1 : pitch]
    return np.stack([x.ravel(), y.ravel()], axis=-1)


def image_of_dots(places, *, radii=RADIUS, shape=SHAPE, noise=0.0, seed=0, light=0.0):
    """(H, W, 3) uint8: soft-edged dots on gray; `light` adds a bump of light in the middle, as a contact does."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    level = 120 + 0.3 * x - 0.2 * y
    level *= 1 + light * np.exp(-((x - shape[1] / 2) ** 2 + (y - shape[0] / 2) ** 2) / 20**2)
    for (px, py), radius in zip(places, np.broadcast_to(radii, len(places))):
        level *= 1 - 0.85 / (1 + np.exp((np.hypot(x - px, y - py) - radius) / 0.4))
    rng = np.random.default_rng(seed)
    pixels = level[..., None] * [0.9, 1.0, 1.1] + rng.normal(0, noise, (*shape, 3))
    return np.clip(np.rint(pixels), 0, 255).astype(np.uint8)
