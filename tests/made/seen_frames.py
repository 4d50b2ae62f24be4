"""Frames as the causes look at them: grey, unchanged, of a calibration whose figures are round."""

import numpy as np

from gelform.confidence.causes.seen import Limits, Seen

CLEAN, WORTH, NOISE = 0.04, 1.5, 0.03
SHAPE = (40, 72)


def limits(**changes):
    """Of a calibration; images of `SHAPE`, of which a grey level is a color change of 0.01."""
    usual = {
        "clean": CLEAN,
        "worth": WORTH,
        "noise": NOISE,
        "levels": 1.5,
        "gain": np.full(SHAPE, 0.01, np.float32),
        "margin_px": 3,
        "outside": None,
        "gamut": None,
        "blur_px": 1.25,
    }
    return Limits(**{**usual, **changes})


def seen(*, of=None, **changes):
    """A frame of level 100 that differs from rest in nothing."""
    grey = np.full((*SHAPE, 3), 100, np.uint8)
    nothing = np.zeros((*SHAPE, 3), np.float32)
    usual = {
        "pixels": grey,
        "color_change": nothing,
        "gradients": nothing[..., :2].copy(),
        "residual": nothing.copy(),
        "markers": None,
        "lost": None,
        "lost_pixels": changes.get("pixels", grey),
        "added_levels": 0.0,
        "limits": of or limits(),
    }
    return Seen(**{**usual, **changes})


def patch(box=np.s_[10:20, 30:44]):
    """A mask (H, W), True in the box."""
    mask = np.zeros(SHAPE, dtype=bool)
    mask[box] = True
    return mask
