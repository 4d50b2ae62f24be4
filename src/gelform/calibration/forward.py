"""What rendering needs beside a color model: colour from slope and depth, and the noise of an image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.background.average import noise_from_image
from gelform.ball import STEEPEST_FRACTION
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.samples import PreparedPress, contact_samples
from gelform.calibration.selection.folds import Fold
from gelform.color_models import ColorModel, Samples
from gelform.color_models._shared.forward import ForwardResponse
from gelform.simulate.twin import GEL_OF, press_depth_of_rim

MAX_NOISE_IMAGES = 12
TOTAL, TOTAL_OF_FOLD = 40_000, 15_000
INNER = 0.85  # part of the contact radius
PER_PRESS = 2_000
# The root mean square of three channels of noise is below 1.61 of its standard deviations at 95 % of the pixels.
MOST, SIGMAS_OF_MOST = 0.95, 1.61


def forward_from_presses(
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    zone: float,
    mm_per_px: float,
    sensor_name: str,
    *,
    total: int = TOTAL,
) -> ForwardResponse:
    """The forward response of presses of balls, with the depths that their visible rims imply.

    Parameters
    ----------
    presses, contacts : prepared, and their circles
    zone : share of the contact radius whose pixels are used
    mm_per_px : pixel pitch, mm
    sensor_name : tells whether the gel is known, see `depth_in_contact`
    total : how many pixels are used, about
    """
    parts = []
    each = total // max(len(presses), 1)
    for press, contact in zip(presses, contacts):
        samples = contact_samples([press], [contact], zone, total=each)
        parts.append(
            (samples, depth_in_contact(samples, contact, press.ball_radius_px, mm_per_px, sensor_name))
        )
    names = ("color_change", "x_px", "y_px", "gradients", "weight")
    joined: dict[str, Any] = {n: np.concatenate([getattr(s, n) for s, _ in parts]) for n in names}
    return ForwardResponse.fit(replace(parts[0][0], **joined), depth_mm=np.concatenate([d for _, d in parts]))


def held_out_noise(
    forwards: Sequence[ForwardResponse],
    models: Sequence[ColorModel],
    folds: Sequence[Fold],
    presses: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
) -> float:
    """Standard deviation of the color change about the forward response, where neither it nor the color model has learnt.

    By the slopes that the model reads, as in use: what both together do not explain of a sound press is no sign of a
    fault. Of few presses, which know few slopes at few places, that is much.

    Parameters
    ----------
    forwards, models : of each fold, fitted without the presses that it holds out
    presses, found : prepared, and their circles
    """
    sizes = []
    for forward, model, fold in zip(forwards, models, folds):
        for press, contact in ((presses[i], found[i]) for i in fold.held_out):
            rows, cols = press.pixels(contact, INNER, PER_PRESS)
            explained = forward.color_from_gradients(press.gradients(model, rows, cols), cols, rows)
            sizes.append(np.sqrt(np.mean(np.square(press.color_change[rows, cols] - explained), axis=-1)))
    return float(np.quantile(np.concatenate(sizes), MOST)) / SIGMAS_OF_MOST


def depth_in_contact(
    samples: Samples, contact: ContactCircle, ball_radius_px: float, mm_per_px: float, sensor_name: str
) -> NDArray[np.float64]:
    """Depth in mm (N,) of samples under a ball whose visible rim is known.

    How far the gel around the contact has sunk is known of a GelSight Mini alone, whose gel was measured. For any other
    sensor depth counts from the rim: the height of the ball's cap.
    """
    radius, rim = ball_radius_px * mm_per_px, contact.radius_px * mm_per_px
    if sensor_name.startswith(GEL_OF):
        top = press_depth_of_rim(radius, rim)
    else:
        top = radius - np.sqrt(radius**2 - min(rim, STEEPEST_FRACTION * radius) ** 2)
    square = ((samples.x_px - contact.x_px) ** 2 + (samples.y_px - contact.y_px) ** 2) * mm_per_px**2
    return np.asarray(top - radius + np.sqrt(np.maximum(radius**2 - square, 0)), dtype=np.float64)


def image_noise(images: Sequence[NDArray[Any]], background: NDArray[np.float32]) -> NDArray[np.float64]:
    """Standard deviation (3,) of an image's pixel, grey levels: the median over some of the images.

    A background is often an average of frames, and quieter than the images that are taken beside it.
    """
    some = images[:: max(1, len(images) // MAX_NOISE_IMAGES)]
    found = [noise_from_image(image.astype(np.float32) - background) for image in some]
    return np.asarray(np.median(found, axis=0), dtype=np.float64)
