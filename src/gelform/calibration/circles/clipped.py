"""Channels of a background image that a camera has clipped: colors there tell little of slopes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform.image.background.surround import surround_of
from gelform.image.frame import DARK
from gelform.image.health import CHANNELS
from gelform.slopes.confidence.causes import SATURATED_FROM

MOST_UNUSABLE = 0.1  # of the pixels of the background image


def light_notes(background: NDArray[np.float32]) -> tuple[str, ...]:
    """The share of the gel where a channel is too dark or saturated, and what to do; () for less than a tenth."""
    outside = surround_of(background)
    gel = background.reshape(-1, 3) if outside is None else background[~outside]
    dark, bright = gel < DARK, gel >= SATURATED_FROM
    share = float((dark | bright).any(axis=-1).mean())
    if share <= MOST_UNUSABLE:
        return ()
    named, remedies = [], []
    for at, said, remedy in (
        (dark, f"below {DARK} gray levels", "raise the light or exposure of the dark channels"),
        (bright, "saturated", "lower the light or exposure of the saturated channels"),
    ):
        parts = zip(CHANNELS, at.mean(axis=0))
        which = [f"{name} in {100 * part:.0f} %" for name, part in parts if part > share / 10]
        if which:
            named.append(f"{', '.join(which)} {said}")
            remedies.append(remedy)
    return (
        f"{100 * share:.0f} % of the background image is at an end of the camera's range ({'; '.join(named)}), where slopes "
        f"hardly change the color: {' and '.join(remedies)}.",
    )
