"""A calibration as the tables from which Taxim, TacEx and Isaac Lab render a sensor's images.

Z. Si and W. Yuan, Taxim: an example-based simulation model for GelSight tactile sensors, RA-L 7(2), 2022. Slopes are binned
by angle and direction. Each bin has, per channel, a quadratic polynomial of the pixel's place for the change in gray levels.
The calibration's forward response fills the table.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gelform.arrays import Numbers
from gelform.calibration_file import Calibration, as_calibration
from gelform.errors import CalibrationError
from gelform.exchange.exporters.press_folder import written_whole
from gelform.foundations.checks import check_choice, check_path
from gelform.foundations.pictures import picture_bytes
from gelform.image.background import image_from_color_change
from gelform.simulate.twin import STEEPEST_RENDERED

RENDERERS = {  # channel (of R, G, B) that each renderer reads from grad_r, grad_g, grad_b
    "taxim": (2, 1, 0),  # its images have OpenCV's order, blue first
    "isaaclab": (0, 1, 2),
}
BINS = 125  # as in Taxim


def save_taxim(
    calibration: Calibration | str | PathLike[str], folder: str | PathLike[str], *, renderer: str = "taxim"
) -> Path:
    """Write `polycalib.npz`, `bg.jpg`, `real_bg.npy` and a note with the renderer's settings for them.

    Parameters
    ----------
    calibration : a Calibration or its file
    folder : new or empty; appears complete or not at all
    renderer : "taxim" (and TacEx), whose `grad_r` is the blue channel, or "isaaclab", whose `grad_r` is the red one

    Returns
    -------
    folder : Path

    Raises
    ------
    CalibrationError
        The calibration was imported without a forward response, or has no mm per px.
    DataError
        The folder is not empty or cannot be written.
    ValueError
        The renderer is unknown.
    """
    calibration, folder = as_calibration(calibration), check_path(folder)
    check_choice(renderer, RENDERERS, "renderer")
    if calibration.mm_per_px is None:
        raise CalibrationError(
            "Expected a calibration with mm_per_px, which a renderer needs. Measure it with gelform scale."
        )
    with written_whole(folder) as partial:
        table = taxim_table(calibration)
        channels = zip(("grad_r", "grad_g", "grad_b"), RENDERERS[renderer])
        arrays: dict[str, Any] = {name: table[:, :, c] for name, c in channels}
        np.savez(partial / "polycalib.npz", bins=BINS, **arrays)
        background = calibration.background
        levels = np.rint(background).astype(np.uint8)
        full_color = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
        jpeg = picture_bytes(levels, ".jpg", (cv2.IMWRITE_JPEG_QUALITY, 100, *full_color))
        (partial / "bg.jpg").write_bytes(jpeg)
        np.save(partial / "real_bg.npy", background[..., list(RENDERERS[renderer])])
        (partial / "settings.txt").write_text(_settings(calibration, renderer), encoding="utf-8")
    return folder


def taxim_table(calibration: Calibration) -> Numbers:
    """Changes in gray levels, (bins, bins, 3, 6): by angle and direction, for R, G, B, in x^2, y^2, xy, x, y, 1.

    Angles run from 0 to 90 degrees, directions of the gradient from -180 to 180, both in BINS - 1 steps. Places are
    pixels of the calibrated image. A level gel changes nothing.

    CalibrationError: the calibration was imported without a forward response.
    """
    calibration.color_from_gradients(np.zeros((*calibration.image_shape, 2)))  # raises without a response
    response: Any = calibration.forward
    # The polynomials are fitted to 9 x 12 pixels spread over the image.
    lines = (np.round(np.linspace(0, n - 1, k)) for n, k in zip(calibration.image_shape, (9, 12)))
    y_px, x_px = (one.ravel() for one in np.meshgrid(*lines, indexing="ij"))
    blurred = cv2.GaussianBlur(calibration.background, (0, 0), 4)  # a quadratic polynomial contains no dust
    untouched = blurred[y_px.astype(int), x_px.astype(int)]
    terms = np.stack([x_px**2, y_px**2, x_px * y_px, x_px, y_px, np.ones(x_px.size)], axis=1)
    fit = np.linalg.pinv(terms)
    angles = (np.arange(BINS) + 0.5) * (np.pi / 2 / (BINS - 1))
    slopes = np.minimum(np.tan(np.minimum(angles, np.pi / 2 - 1e-6)), STEEPEST_RENDERED)
    slopes[0] = 0
    directions = (np.arange(BINS) + 0.5) * (2 * np.pi / (BINS - 1)) - np.pi
    table = np.empty((BINS, BINS, 3, 6))
    for steepness, slope in enumerate(slopes):
        gradients = slope * np.stack([np.cos(directions), np.sin(directions)], axis=-1)
        change = response.color_from_gradients(
            np.repeat(gradients, x_px.size, axis=0), np.tile(x_px, BINS), np.tile(y_px, BINS)
        )
        background = np.tile(untouched, (BINS, 1, 1))
        levels = image_from_color_change(change.reshape(background.shape), background, calibration.change)
        table[steepness] = np.einsum("kp,dpc->dck", fit, levels.astype(np.float64) - background)
    return table


def _settings(calibration: Calibration, renderer: str) -> str:
    height, width = calibration.image_shape
    if renderer == "isaaclab":
        return (
            "GelSightRenderCfg(\n"
            '    base_data_path="<the folder above this one>",\n'
            '    sensor_data_dir_name="<this folder>",\n'
            f"    image_height={height},\n    image_width={width},\n    num_bins={BINS},\n"
            f"    mm_per_pixel={calibration.mm_per_px:.6g},\n)\n"
        )
    return f"h = {height}\nw = {width}\npixmm = {calibration.mm_per_px:.6g}\nnumBins = {BINS}\n"
