"""The light of a make of sensor on gel at rest: thirty numbers that units share up to brightness and white balance.

A smooth surface is fitted to the logarithm of each channel of a background image. Two units of one make differ in the
brightness of each channel, in dust and in scratches. The pattern of colors over the gel is the same, because it follows
from the positions of the lamps. No pixel of an image can be recovered from it.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.errors import CalibrationError
from gelform.foundations.findings import Finding
from gelform.image.background.orientation import READINGS
from gelform.image.background.surround import surround_finding
from gelform.slopes.color_models._shared.least_squares import node_positions

DEGREE = 3  # degree of the polynomial in x and y
BLOCKS = 16  # blocks along the longer side; the surface is fitted to their means
OFFSET = 1.0  # gray levels, so that black has a logarithm
# Correlation of the patterns of color: units of one make 0.94-0.99, with a touch 0.80 or more, other makes under 0.5.
LEAST_ALIKE, SURELY_ALIKE = 0.7, 0.9
# The pattern of a mirrored, turned or BGR image correlates better by at least this when it is read so. Left and right of a
# Mini differ by less: 0.98 and 0.96.
CLEARLY_ALIKE = 0.1
# RMS of the logarithm about the surface: clean units 0.04-0.06, a Mini with the gel's rim in sight 0.11, touched ones more.
ROUGH = 0.12


def light_from_background(background: NDArray[Any]) -> tuple[NDArray[np.float64], float]:
    """The light of a background image (H, W, 3), 0-255, and the image's distance from it.

    Returns
    -------
    light : (10, 3) coefficients of each channel's logarithm, polynomials of the third degree in x and y
    rough : RMS difference of the logarithms of about 16 x 12 blocks; dust, scratches and touches raise it
    """
    height, width = background.shape[:2]
    step = max(height, width) / BLOCKS
    size = (max(4, round(width / step)), max(4, round(height / step)))
    blocks = cv2.resize(np.asarray(background, dtype=np.float32), size, interpolation=cv2.INTER_AREA)
    target = np.log(blocks.astype(np.float64) + OFFSET).reshape(-1, 3)
    x, y = ((np.arange(n) + 0.5) / n for n in size)
    design = _terms(*np.meshgrid(x, y))
    light = np.linalg.lstsq(design, target, rcond=None)[0]
    return light, float(np.sqrt(np.mean((design @ light - target) ** 2)))


def levels_from_light(light: NDArray[np.float64], x: NDArray[Any], y: NDArray[Any]) -> NDArray[np.float32]:
    """Gray levels (..., 3) of a light at positions 0-1 across the width and down the height, of equal shapes (...)."""
    levels = np.exp(_terms(x, y) @ light) - OFFSET
    return np.clip(levels, 0, 255).astype(np.float32).reshape(*np.shape(x), 3)


def pixel_places(
    columns: NDArray[Any], rows: NDArray[Any], shape: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions 0-1 of the pixels at crossings of columns and rows of images (H, W); nodes beyond the border lie on it."""
    x, y = (np.clip((np.asarray(along) + 0.5) / n, 0, 1) for along, n in zip((columns, rows), shape[::-1]))
    across, down = np.meshgrid(x, y)
    return across, down


def gain_between(
    light: NDArray[np.float64],
    usual: NDArray[np.float64],
    offset: float,
    shape: tuple[int, int],
    wider: float = 1.0,
) -> NDArray[np.float64]:
    """Usual color change over the color change under a light, at the nodes: (rows, columns, 3).

    A color change is divided by the light plus `offset` gray levels; the offset weighs more in a darker unit. The pixels
    under this light are `wider` times as wide on the gel as those under the usual one.
    """
    rows, columns = node_positions(shape)
    places = pixel_places(columns, rows, shape)
    usual_places = (np.clip(0.5 + wider * (along - 0.5), 0, 1) for along in places)
    own, other = (
        np.maximum(levels_from_light(one, *at).astype(np.float64), 1)
        for one, at in ((light, places), (usual, usual_places))
    )
    return (1 + offset / own) / (1 + offset / other)


def check_light(background: NDArray[Any], light: NDArray[np.float64], make: str) -> tuple[Finding, ...]:
    """Refuse a background image without the colors of a make of sensor; return findings.

    Brightness and white balance are free: the pattern of colors over the gel is compared, not the pixels.

    Raises
    ------
    CalibrationError
        Another make, a turned or mirrored image, or BGR. The message has the figure.
    """
    own, rough = light_from_background(background)
    alike = _alike(own, light)
    if alike < SURELY_ALIKE:
        _check_upright(background, light, make, alike)
    surround = surround_finding(background, "crop the frames to {} (left, top, width, height)")
    if alike < LEAST_ALIKE:
        raise CalibrationError(
            f"Expected the background of a {make}: the colors over its gel correlate by {alike:.2f} with those of its make "
            f"(expected {LEAST_ALIKE} or more). Is it another sensor? Name the right one, or calibrate it with presses of a "
            f"ball.{'' if surround is None else f' {surround.message}'}"
        )
    findings = [] if surround is None else [surround]
    if alike < SURELY_ALIKE:
        message = (
            f"The colors over this gel correlate by {alike:.2f} with those of a {make} (usual: {SURELY_ALIKE} or more). It "
            "is another gel, or something touches it. Calibrate with presses of a ball before you trust a figure."
        )
        findings.append(Finding("starter_light", message, alike))
    if rough > ROUGH:
        message = (
            f"The background is uneven. Blocks differ by {100 * rough:.0f} % from a smooth light (usual: under "
            f"{100 * ROUGH:.0f} %). Something touches the gel, or it is scratched, dusty or marked."
        )
        findings.append(Finding("uneven_background", message, rough))
    return tuple(findings)


def _check_upright(background: NDArray[Any], light: NDArray[np.float64], make: str, alike: float) -> None:
    """Raise a CalibrationError if a background image is clearly more like the make's light when it is read otherwise.

    Several readings are named where the light does not tell them apart.
    """
    turned = {
        one: _alike(light_from_background(one.undone(background))[0], light)
        for one in READINGS
        if not one.transposed
    }
    best = max(turned.values())
    if best <= max(alike + CLEARLY_ALIKE, LEAST_ALIKE):
        return
    likely = sorted(
        (one for one in turned if turned[one] > best - CLEARLY_ALIKE), key=turned.__getitem__, reverse=True
    )
    raise CalibrationError(
        f"The background is {', or '.join(one.named for one in likely)}: so its colors fit a {make} (correlation {best:.2f} "
        f"against {alike:.2f}). Undo it where images are read: {', or '.join(one.remedy for one in likely)}."
    )


def _terms(x: NDArray[Any], y: NDArray[Any]) -> NDArray[np.float64]:
    """Legendre polynomials (N, 10) of positions 0-1, up to the third total degree."""
    across, down = (np.polynomial.legendre.legvander(2 * np.ravel(a) - 1, DEGREE) for a in (x, y))
    pairs = [(i, j) for j in range(DEGREE + 1) for i in range(DEGREE + 1 - j)]
    return np.stack([across[:, i] * down[:, j] for i, j in pairs], axis=1)


def _alike(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Correlation of the patterns of color of two lights: each channel relative to the channels' mean, over the gel."""
    x, y = np.meshgrid(*((np.arange(BLOCKS) + 0.5) / BLOCKS,) * 2)
    patterns = []
    for light in (one, other):
        surface = _terms(x, y)[:, 1:] @ light[1:]
        pattern = surface - surface.mean(axis=1, keepdims=True)
        patterns.append((pattern - pattern.mean(axis=0)).ravel())
    a, b = patterns
    return float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-12))
