"""frames of the gel at rest -> background: a robust average that leaves touched frames out by name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.errors import DataError
from gelform.foundations.checks import check_image
from gelform.foundations.filters import SIGMA_OF_MEDIAN
from gelform.image.background.light import block_means

USUAL_FRAMES = 15  # frames at rest that are averaged where they come by themselves
# Bytes of frames that are held, and of rows that are sorted at once.
MAX_BYTES, ROWS_BYTES = 192 * 2**20, 32 * 2**20
TRIMMED_FRACTION = 0.2  # fraction of a pixel's values that is cut off at each end
# A block is touched if it is off by 3 % of its level, 1.5 gray levels and 6 sigma of noise; a frame is touched if such a
# fraction of its blocks is.
BLOCK_LEVELS, BLOCK_SIGMAS, TOUCHED_BLOCKS = 1.5, 6.0, 0.01
OTHER_LEVEL = (
    0.03  # fraction of the brightness: a touched block, or a frame of another exposure, differs by more
)
KEPT_VARIANCES = (
    0.99  # fraction of the pixels; one in a hundred may flicker, such as a fiber or an edge that trembles
)


class Background(NamedTuple):
    """An average of frames of the gel at rest.

    Attributes
    ----------
    background : (H, W, 3) float32, 0-255
    noise : (3,) float64, standard deviation of a pixel in one frame, gray levels
    left_out : (name, why) of each frame that is not in the average
    """

    background: NDArray[np.float32]
    noise: NDArray[np.float64]
    left_out: tuple[tuple[str, str], ...]


def background_from_frames(
    frames: Iterable[ArrayLike], *, names: Sequence[str] | None = None, max_bytes: int = MAX_BYTES
) -> Background:
    """A robust average of frames of the gel at rest.

    Frames that differ from the median of all by a touch, a shadow or another exposure are left out. From the
    others, the highest and the lowest fifth of each pixel's values are cut off, and the rest is averaged (a trimmed mean:
    P. J. Huber and E. M. Ronchetti, Robust Statistics, 2nd edition, 2009, section 1.3).

    Parameters
    ----------
    frames : (H, W, 3) each, RGB, 0-255; taken one at a time
    names : names of the frames in messages; "frame 0", "frame 1", ... by default
    max_bytes : of frames that are held at once; beyond that, evenly spaced frames are kept

    Returns
    -------
    Background
        (background, noise, left_out). The noise of a single frame is estimated from second differences along rows.

    Raises
    ------
    DataError
        No frame, or fewer than half agree with the median of all; then none is surely at rest.
    ValueError, TypeError
        A frame that is no RGB image, or of another size than the first.
    """
    kept = _kept(frames, names, max_bytes)
    if not kept:
        raise DataError("Expected frames of the gel at rest, got none.")
    left_out = _odd_ones(kept)
    good = [image for name, image in kept if name not in left_out]
    if 2 * len(good) <= len(kept) and len(kept) > 1:
        listed = "; ".join(f"{name}: {why}" for name, why in list(left_out.items())[:4])
        raise DataError(
            f"Expected frames of the gel at rest that agree, got {len(left_out)} of {len(kept)} that differ from "
            f"the median of all ({listed}). Take them again with nothing on the gel and the exposure fixed."
        )
    average, noise = trimmed_mean(good)
    return Background(average, noise, tuple(left_out.items()))


def noise_from_image(image: NDArray[Any]) -> NDArray[np.float64]:
    """Standard deviation (3,) of a pixel, gray levels, from second differences along rows (robust).

    Parameters
    ----------
    image : (H, W, 3), or the difference of two images; smooth along rows except for its noise
    """
    pixels = np.asarray(image, dtype=np.float32)
    second = pixels[:, 2:] - 2 * pixels[:, 1:-1] + pixels[:, :-2]
    middle = np.median(np.abs(second), axis=(0, 1)).astype(np.float64)
    return np.asarray(SIGMA_OF_MEDIAN * middle / np.sqrt(6), dtype=np.float64)


def _kept(
    frames: Iterable[ArrayLike], names: Sequence[str] | None, max_bytes: int
) -> list[tuple[str, NDArray[Any]]]:
    """Every k-th frame; k is doubled each time the frames would exceed `max_bytes`."""
    kept: list[tuple[str, NDArray[Any]]] = []
    stride = 1
    if not isinstance(frames, Iterable) or isinstance(frames, (str, bytes, Mapping)):
        raise TypeError(f"Expected frames as several images (H, W, 3), got {type(frames).__name__}.")
    for number, frame in enumerate(frames):
        if number % stride:
            continue
        image = check_image(frame, shape=kept[0][1].shape[:2] if kept else None, name="frame")
        kept.append((names[number] if names is not None else f"frame {number}", image.copy()))
        if len(kept) > 8 and sum(one.nbytes for _, one in kept) > max_bytes:
            kept, stride = kept[::2], 2 * stride
    return kept


def _odd_ones(kept: Sequence[tuple[str, NDArray[Any]]]) -> dict[str, str]:
    """Names of the frames that differ from the median of all, with the reason."""
    blocks = np.stack([block_means(image) for _, image in kept])
    middle = np.median(blocks, axis=0)
    odd = {}
    for (name, _), own in zip(kept, blocks):
        gain = np.median((own + 1) / (middle + 1), axis=(0, 1))
        off = np.abs(own - gain * middle)
        noise = SIGMA_OF_MEDIAN * np.median(off, axis=(0, 1))
        touched = (off > OTHER_LEVEL * middle + BLOCK_LEVELS + BLOCK_SIGMAS * noise).any(axis=-1).mean()
        brighter = float(gain[np.argmax(np.abs(gain - 1))] - 1)
        if touched > TOUCHED_BLOCKS:
            odd[name] = f"{100 * touched:.1f} % of it differs, by a touch or a shadow"
        elif abs(brighter) > OTHER_LEVEL:
            odd[name] = f"another exposure, {100 * brighter:+.0f} %"
    return odd


def trimmed_mean(images: Sequence[NDArray[Any]]) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Mean of frames without the highest and the lowest fifth of each pixel's values, and their noise (3,), gray levels.

    No frame is left out; it is for frames that are known to be at rest.
    """
    if len(images) == 1:
        return images[0].astype(np.float32), noise_from_image(images[0])
    height = images[0].shape[0]
    cut = int(TRIMMED_FRACTION * len(images))
    rows = max(1, ROWS_BYTES // (len(images) * images[0][0].nbytes))
    average = np.empty(images[0].shape, dtype=np.float32)
    variances = []
    for first in range(0, height, rows):
        stack = np.sort(np.stack([image[first : first + rows] for image in images]), axis=0)
        average[first : first + rows] = stack[cut : len(images) - cut].mean(axis=0, dtype=np.float64)
        variances.append(stack.var(axis=0, ddof=1, dtype=np.float64).reshape(-1, 3))
    variance = np.sort(np.concatenate(variances), axis=0)
    kept = max(1, int(KEPT_VARIANCES * len(variance)))
    return average, np.sqrt(variance[:kept].mean(axis=0))
