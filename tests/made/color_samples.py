"""Samples of a ball under simple lights, for tests of color models."""

import numpy as np

from gelform.slopes.color_models import Samples

SHAPE = (48, 64)
LIGHTS = np.array([[0.8, 0.1, 0.9], [-0.5, 0.6, 0.8], [-0.2, -0.9, 1.1]])


def ball_samples(change_of, count: int = 4000, seed: int = 0) -> Samples:
    """Random pixels with slopes up to 0.8, their color change by a given law of (gradients, x, y)."""
    rng = np.random.default_rng(seed)
    steepness, angle = 0.8 * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    gradients = np.stack([steepness * np.cos(angle), steepness * np.sin(angle)], axis=-1)
    x, y = rng.uniform(0, SHAPE[1] - 1, count), rng.uniform(0, SHAPE[0] - 1, count)
    return Samples(change_of(gradients, x, y), x, y, gradients, np.ones(count), SHAPE)


def lambertian_change(gradients, x, y):
    """I/I0 - 1 of a Lambertian gel under three fixed lights."""
    length = np.sqrt(1 + np.sum(gradients**2, axis=-1))
    normals = np.concatenate([-gradients, np.ones((len(gradients), 1))], axis=-1) / length[:, None]
    return np.maximum(normals @ LIGHTS.T, 0) / LIGHTS[:, 2] - 1


def shading_change(gradients, x, y):
    """The same with lights that turn over the image, as near lights do."""
    turn = (x / SHAPE[1] - 0.5)[:, None] * np.array([0.3, -0.2, 0.25])
    return lambertian_change(gradients, x, y) * (1 + turn)
