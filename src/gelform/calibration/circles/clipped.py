"""Channels of a background image that a camera has clipped: colors there tell little of slopes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform.image.background.surround import surround_of
from gelform.image.frame import DARK
from gelform.slopes.confidence.causes import SATURATED_FROM

MOST_UNUSABLE = 0.1  # of the pixels of the background image
NAMES = ("red", "green", "blue")


def light_notes(background: NDArray[np.float32]) -> tuple[str, ...]:
    """The share of the gel where a channel is too dark or saturated, and what to do; () for less than a tenth."""
    outside = surround_of(background)
    gel = background.reshape(-1, 3) if outside is None else background[~outside]
    ends = {"dark": gel < DARK, "bright": gel >= SATURATED_FROM}
    share = float((ends["dark"] | ends["bright"]).any(axis=-1).mean())
    if share <= MOST_UNUSABLE:
        return ()
    said = {"dark": f"below {DARK} gray levels", "bright": "saturated"}
    parts = {
        kind: [
            f"{name} in {100 * part:.0f} %" for name, part in zip(NAMES, at.mean(axis=0)) if part > share / 10
        ]
        for kind, at in ends.items()
    }
    named = "; ".join(f"{', '.join(which)} {said[kind]}" for kind, which in parts.items() if which)
    do = {
        "dark": "raise the light or exposure of the dark channels",
        "bright": "lower the light or exposure of the saturated channels",
    }
    remedy = " and ".join(do[kind] for kind, which in parts.items() if which)
    return (
        f"{100 * share:.0f} % of the background image is at an end of the camera's range ({named}), where slopes hardly "
        f"change the color: {remedy}.",
    )
