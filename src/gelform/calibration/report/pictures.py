"""The report's pictures as data URLs, and the presses' names under them."""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

# px, widths of a press's picture; the first that the budget allows is used.
WIDTHS_PX = (320, 240, 160, 112, 80, 56)
TILE_PX = 56  # px of a picture of depth minus cap
HIGH, LOW = (214, 69, 65), (40, 110, 200)  # RGB of depth above and below the ball


def short_names(names: Sequence[str], length: int = 28) -> list[str]:
    """Names without their common ending (`/gelsight.png`, `.png`); long ones lose their middle."""
    ending = os.path.commonprefix([name[::-1] for name in names])[::-1]  # noqa: RUF071 (letters are meant)
    cut = max(ending.find("/"), 0) if "/" in ending else max(ending.rfind("."), 0)
    shared = len(ending) - cut if ending[cut : cut + 1] in ("/", ".") else 0
    short = [name[: len(name) - shared] or name for name in names]
    return [
        name if len(name) <= length else f"{name[: length // 2 - 1]}…{name[len(name) - length // 2 :]}"
        for name in short
    ]


def jpeg_url(image: NDArray[np.uint8], width_px: int) -> str:
    """An RGB image, not wider than `width_px`, as a JPEG data URL."""
    height, width = image.shape[:2]
    if width > width_px:
        size = (width_px, max(1, round(height * width_px / width)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    settings = [int(cv2.IMWRITE_JPEG_QUALITY), 82]
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), settings)
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


def press_urls(images: Sequence[NDArray[np.uint8]], budget_bytes: int = 1_300_000) -> list[str]:
    """All presses as wide as the page's budget allows, which keeps it under 3 MB; hundreds become small."""
    for width in WIDTHS_PX:
        each = len(jpeg_url(images[len(images) // 2], width))
        if each * len(images) <= budget_bytes:
            break
    return [jpeg_url(image, width) for image in images]


def cap_scale_um(maps: Sequence[NDArray[np.float32]]) -> float:
    """The depth error of the tiles' full color: a round figure that few pixels exceed."""
    typical = float(np.nanquantile(np.abs(np.concatenate([one[::2, ::2].ravel() for one in maps])), 0.97))
    power = 10.0 ** np.floor(np.log10(max(typical, 1e-3)))
    return float(next(step * power for step in (1, 1.5, 2, 3, 5, 7, 10) if step * power >= typical))


def cap_url(error_um: NDArray[np.float32], scale_um: float) -> str:
    """Depth minus the cap as a PNG data URL: red above the ball, blue below, clear where it agrees or is unknown."""
    known = np.isfinite(error_um)
    ratio = np.where(known, np.clip(np.nan_to_num(error_um) / scale_um, -1, 1), 0)
    color = np.where(ratio[..., None] > 0, HIGH, LOW)
    alpha = np.where(known, 255 * np.abs(ratio), 0)
    pixels = np.dstack([color[..., ::-1], alpha]).astype(np.uint8)
    longest = max(pixels.shape[:2])
    if longest > TILE_PX:
        size = tuple(max(1, round(n * TILE_PX / longest)) for n in pixels.shape[1::-1])
        pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    _, data = cv2.imencode(".png", pixels)
    return "data:image/png;base64," + base64.b64encode(data.tobytes()).decode()
