"""Presses in, from folders, other packages' layouts and videos: a press set."""

from gelform.calibration.presses.adjust import with_crosstalk, with_scale, with_view
from gelform.calibration.presses.folder import SOURCES, as_presses, kind_of_presses, read_presses
from gelform.calibration.presses.press_set import Press, Presses
from gelform.calibration.presses.video import presses_from_frames

__all__ = [
    "SOURCES",
    "Press",
    "Presses",
    "as_presses",
    "kind_of_presses",
    "presses_from_frames",
    "read_presses",
    "with_crosstalk",
    "with_scale",
    "with_view",
]
