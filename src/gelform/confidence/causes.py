"""What makes a slope uncertain beyond what its step and place say: one row for each cause."""

from __future__ import annotations

from typing import NamedTuple


class Cause(NamedTuple):
    """One cause of doubt.

    Attributes
    ----------
    sentence : what is said of the pixels that it is named for; "" where it is never named
    named_from : standard deviation, mm/mm, that it has to add to a slope to be named
    """

    sentence: str
    named_from: float


LEAVES_NOTHING = 0.35  # mm/mm: about the slope of a ball's rim
SIX_SIGMA = 7.0  # mm/mm, what a residual of 6 sigma adds: rims of real presses leave up to 5
CAUSES = {
    "saturated": Cause("at the camera's upper end. Lower exposure, gain or the lights.", LEAVES_NOTHING),
    "dark": Cause("at the camera's lower end. Is a light off, or the exposure too short?", LEAVES_NOTHING),
    "shadow": Cause("darker than any slope makes it: a cast shadow.", SIX_SIGMA),
    "specular": Cause("brighter than any slope makes it: a mirrored light.", SIX_SIGMA),
    "off_gamut": Cause(
        "of colours that no slope gives: dust, a scratch, another gel, or slopes that no training press has shown.",
        SIX_SIGMA,
    ),
    "inconsistent": Cause("torn, or another moment's: data of the frame were lost.", LEAVES_NOTHING),
    "marker": Cause("hidden by markers.", LEAVES_NOTHING),
    "outside": Cause("not lit, or not gel.", LEAVES_NOTHING),
    "wall": Cause("", LEAVES_NOTHING),  # an object's edge is no fault
    "compression": Cause(
        "noisier than the calibrated images. Raise the JPEG quality, or lower the camera's gain.", 0.0
    ),
}
