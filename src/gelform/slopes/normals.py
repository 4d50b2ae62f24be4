"""Photometric stereo: three lights, three channels, one normal and one albedo per pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gelform._native import Kernel
from gelform.arrays import Array, Map, Numbers, Slopes
from gelform.foundations.checks import check_gradients, check_normals, check_values
from gelform.slopes.color_models.physical import check_lights, inverse_lights

_normals_of_slopes = Kernel("normals_of_slopes", "f32[n,2] slopes, out f32[n,3] normals")


def normals_from_image(image: ArrayLike, lights: ArrayLike) -> tuple[Map, Map]:
    """Normals and albedo from linear intensities under three fixed lights.

    Solves `I = L rho n` for `g = rho n = L^-1 I`; then `n = g/|g|` and `rho = |g|`.

    Parameters
    ----------
    image : (..., 3), linear intensity per channel (no gamma), any unit
    lights : (3, 3); row c is the direction toward the light that channel c sees, times its strength

    Returns
    -------
    normals : (..., 3) float32, unit length; (0, 0, 1) where all channels are 0
    albedo : (...) float32, in the unit of image over lights

    Raises
    ------
    ValueError
        The lights are coplanar or nearly so: the message names the condition number.

    Notes
    -----
    R. J. Woodham, Photometric method for determining surface orientation from multiple images,
    Optical Engineering 19(1), 1980, eq. 7.
    """
    g = check_values(image, "image", (3,)) @ inverse_lights(lights).astype(np.float32).T
    albedo = np.linalg.norm(g, axis=-1)
    lit = albedo > 0
    up = np.array([0, 0, 1], dtype=np.float32)
    normals = np.where(lit[..., None], g / np.where(lit, albedo, 1)[..., None], up)
    return normals.astype(np.float32), albedo.astype(np.float32)


def image_from_normals(normals: ArrayLike, lights: ArrayLike, albedo: ArrayLike = 1.0) -> Map:
    """Lambertian shading `I_c = rho max(0, n @ l_c)`: what `normals_from_image` inverts.

    A pixel that faces away from a light (`n . l < 0`) gets none of it: the attached shadow.

    Parameters
    ----------
    normals : (..., 3), n_z > 0
    lights : (3, 3); row c is the direction toward light c times its strength
    albedo : scalar or (...)

    Returns
    -------
    image : (..., 3) float32, linear intensity

    Raises
    ------
    ValueError, TypeError
        Normals, lights or albedo of another shape, not finite, or normals that face away (n_z <= 0).
    """
    n = _unit(check_normals(normals))
    shading = np.maximum(n @ check_lights(lights).T, 0)
    return (_albedo(albedo, n.shape[:-1])[..., None] * shading).astype(np.float32)


def normals_from_gradients(gradients: ArrayLike) -> Slopes:
    """Unit normals `(-p, -q, 1)/sqrt(1 + p^2 + q^2)` of slopes p = dz/dx, q = dz/dy.

    Parameters
    ----------
    gradients : (..., H, W, 2), mm/mm

    Returns
    -------
    normals : (..., H, W, 3) float32, unit length, n_z > 0

    Raises
    ------
    ValueError, TypeError
        Slopes of another shape, or not finite.
    """
    return normals_of(check_gradients(gradients))


def normals_of(slopes: Slopes) -> Slopes:
    """`normals_from_gradients` of slopes (..., 2) that are float32 and finite, in C order."""
    normals = np.empty((*slopes.shape[:-1], 3), np.float32)
    _normals_of_slopes(slopes.reshape(-1, 2), normals.reshape(-1, 3))
    return normals


def lights_from_normals(image: ArrayLike, normals: ArrayLike, albedo: ArrayLike = 1.0) -> Numbers:
    """The light matrix L that explains an image of known normals best (least squares per channel).

    A channel that sees nothing of its light at a pixel (the attached shadow: value 0) says nothing there
    and is left out.

    Parameters
    ----------
    image : (..., 3), linear intensity
    normals : (..., 3), such as the normals of a pressed ball
    albedo : scalar or (...)

    Returns
    -------
    lights : (3, 3) float64, row c for channel c

    Raises
    ------
    ValueError
        Fewer than three lit pixels in a channel, or normals that do not span three dimensions.
    """
    intensity = check_values(image, "image", (3,), np.float64).reshape(-1, 3)
    facing = check_normals(normals)
    scaled = (_albedo(albedo, facing.shape[:-1])[..., None] * facing).reshape(-1, 3)
    if scaled.shape != intensity.shape:
        raise ValueError(
            f"Expected image and normals of one shape, got {np.shape(image)} and {np.shape(normals)}."
        )
    lights = np.empty((3, 3))
    for channel in range(3):
        lit = intensity[:, channel] > 0
        if np.count_nonzero(lit) < 3 or np.linalg.matrix_rank(scaled[lit], tol=1e-6 * lit.sum() ** 0.5) < 3:
            raise ValueError(
                f"Expected lit pixels of at least three different normals in channel {channel}, got fewer: "
                "the light is not determined. Use a press of a ball, whose normals point everywhere."
            )
        lights[channel] = np.linalg.lstsq(scaled[lit], intensity[lit, channel], rcond=None)[0]
    return lights


def _albedo(albedo: ArrayLike, shape: tuple[int, ...]) -> Array:
    """A scalar, or a map of the image's shape."""
    array = check_values(albedo, "albedo", dtype=np.float64)
    if array.shape not in ((), shape):
        raise ValueError(f"Expected albedo as a number or of shape {shape}, got {array.shape}.")
    return array


def _unit(vectors: Array) -> Map:
    return (vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)).astype(np.float32)
