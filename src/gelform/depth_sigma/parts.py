"""How slope errors split into white and correlated ones: otherwise where the gel is untouched than in a contact."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gelform.depth_sigma.closed_form import white_as_blurred

LEAST = 1e-6


@dataclass(frozen=True)
class ErrorParts:
    """Parts of the variance of slope errors.

    In a contact a share of it is correlated over a long distance (a color model's bias) and the rest is white. At rest
    no color model errs: what is left is the images' noise, blurred as the color change is. Over a block of pixels such
    short correlations are as good as independent errors of more variance.

    Attributes
    ----------
    block : pixels across a block
    share : correlated share in a contact, 0-1
    rest_share : share at rest that is correlated as in a contact, 0-1
    rest_px : distance over which the other part falls to exp(-1/2) at rest; 0: it is white
    aspect : pitch along x over that along y
    """

    block: int
    share: float
    rest_share: float
    rest_px: float
    aspect: float = 1.0

    @property
    def of_blocks(self) -> tuple[float, float, float]:
        """Shares of the variance that are correlated, in contact and at rest; power of the others at rest."""
        power = white_as_blurred(self.aspect, self.block, self.rest_px)[0]
        return self.share, self.rest_share, power

    @cached_property
    def within_blocks(self) -> NDArray[np.float32]:
        """(2,), in contact and at rest: share of the deviation that, if it is white, moves depth as far within a block."""
        within = white_as_blurred(self.aspect, self.block, self.rest_px)[1]
        contact, rest = np.sqrt(1 - self.share), np.sqrt((1 - self.rest_share) * within)
        return np.maximum([contact, rest], LEAST, dtype=np.float32)
