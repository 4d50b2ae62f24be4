"""Taxim's table of a smooth law: each channel lit from its side, more so to the right and below."""

import numpy as np

LIGHTS = np.array([[0.5, 0.1], [-0.3, 0.4], [-0.2, -0.5]])  # of the channels R, G, B


def taxim_arrays(bins=90, shape=(480, 640)):
    """The law as Taxim writes it: in gray levels, over pixel positions, blue first."""
    angle = (np.arange(bins) + 0.5) * np.pi / 2 / (bins - 1)
    turn = (np.arange(bins) + 0.5) * 2 * np.pi / (bins - 1) - np.pi
    steep = np.tan(np.minimum(angle, 1.5))[:, None]
    p, q = steep * np.cos(turn), steep * np.sin(turn)
    tables = []
    for light in LIGHTS:
        value = 255 * (light[0] * p + light[1] * q) / np.sqrt(1 + p**2 + q**2)
        powers = np.zeros(6)
        powers[1], powers[3], powers[5] = 0.2 / shape[0] ** 2, 0.3 / shape[1], 0.6
        tables.append(value[..., None] * powers)
    return {"bins": np.array(bins), "grad_r": tables[2], "grad_g": tables[1], "grad_b": tables[0]}
