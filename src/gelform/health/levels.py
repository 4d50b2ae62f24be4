"""Dark and saturated: parts of a frame that lie at an end of the camera's range, where the rest image does not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform.background.check import Finding
from gelform.health.blocks import Blocks

DARK, LIT = 8, 16  # a block's mean grey level; the rest image's, from which on darkness says something
SATURATED, BELOW = 252, 240
MIN_SHARE = 0.05  # of the frame; a hard contact saturates or shades less than this on good sensors
CHANNELS = ("red", "green", "blue")


class Levels:
    """Finds dark and saturated blocks of frames; prepared once for an untouched image.

    A block counts in one channel already: slopes need all three lights.

    Parameters
    ----------
    rest : blocks of the untouched image

    Attributes
    ----------
    dark_to, saturated_from : (h, w, 3) uint8, means below or from which on a channel of a block counts
    """

    def __init__(self, rest: Blocks) -> None:
        # Levels are compared as integers of the blocks' own type: -1 and 256 have no place in it.
        self.dark_to = np.where(rest.means >= LIT, DARK, 0).astype(np.uint8)
        self.saturated_from = np.where(rest.means < BELOW, SATURATED, 255).astype(np.uint8)
        self._may_saturate = rest.means < BELOW

    def __call__(
        self, blocks: Blocks, torn: NDArray[np.bool_] | None = None
    ) -> tuple[tuple[Finding, ...], NDArray[np.bool_] | None]:
        """Findings `dark` and `saturated`, and the blocks (h, w) concerned; None where there are none.

        Parameters
        ----------
        blocks : of the frame
        torn : (h, w) blocks that are counted elsewhere
        """
        dark = blocks.means < self.dark_to
        saturated = blocks.means >= self.saturated_from
        if not (dark.any() or saturated.any()):
            return (), None
        saturated &= self._may_saturate
        if torn is not None:
            dark[torn] = saturated[torn] = False
        findings = [
            _finding(
                "dark", dark, f"below {DARK} of 255 grey levels", "Is a light off, or the lens covered?"
            ),
            _finding(
                "saturated", saturated, "at the camera's upper end", "Lower exposure, gain or the lights."
            ),
        ]
        named = tuple(finding for finding in findings if finding is not None)
        return named, np.any(dark | saturated, axis=-1) if named else None


def _finding(name: str, where: NDArray[np.bool_], what: str, advice: str) -> Finding | None:
    """A finding whose figure is the share of the frame, of the channel where that is largest."""
    shares = where.mean(axis=(0, 1)) if where.size else np.zeros(3)
    if shares.max() < MIN_SHARE:
        return None
    said = ", ".join(
        f"{channel} {100 * share:.0f} %" for channel, share in zip(CHANNELS, shares) if share > 0
    )
    return Finding(name, f"Parts of the frame are {what}: {said}. {advice}", float(shares.max()))
