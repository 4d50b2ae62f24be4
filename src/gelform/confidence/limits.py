"""What a calibration and today's untouched image say of the causes: prepared once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.background.change import ChangeSettings, gain_from_background
from gelform.color_models._shared.forward import ForwardResponse
from gelform.color_models._shared.gamut import Gamut
from gelform.confidence.cast_shadows import CastShadows
from gelform.confidence.causes.outside import outside_of_gel
from gelform.confidence.causes.seen import Limits
from gelform.confidence.forward_cells import coefficients_of_cells
from gelform.confidence.raised import PreparedCauses

USUAL_WORTH = 1.0  # mm/mm for a color change of 1, where no training press is known
BLOOMS_PX = 1  # beside what the color change's blur reaches


def noise_of(forward: ForwardResponse) -> float:
    """Standard deviation of the color change about a forward response, RMS of the channels: that of held-out presses.

    Of few presses it knows a few slopes at a few places, and its own noise is small there: it would call the others
    shadow, specular or inconsistent and take a touch away. The noise on held-out presses says so, and what is not beyond
    it raises no sigma. Calibrations that do not hold it go by the noise of the training presses.
    """
    own = float(np.sqrt(np.mean(np.square(forward.noise))))
    return max(own, forward.held_out_noise or 0.0)


def prepared_causes(
    background: NDArray[np.float32],
    change: ChangeSettings,
    *,
    clean: float,
    levels: Any | None,
    gamut: Gamut | None,
    forward: ForwardResponse | None,
    shadows: bool = True,
) -> PreparedCauses:
    """The causes of frames of one calibration over one background.

    Parameters
    ----------
    background : (H, W, 3), 0-255, the untouched image in use
    change : how images become color changes
    clean : standard deviation of a slope of confidence 1, mm/mm
    levels : standard deviation of the calibrated images' pixels, grey levels, of each channel; None where not known
    gamut : colours of the training presses; without it no colour is off gamut
    forward : the forward response; without it nothing is called shadow, specular or inconsistent
    shadows : whether cast shadows are looked for, on sensors whose presses cast some
    """
    limits = Limits(
        clean=clean,
        worth=USUAL_WORTH if gamut is None else gamut.slope_per_change,
        noise=None if forward is None else noise_of(forward),
        levels=np.inf if levels is None else float(np.sqrt(np.mean(np.square(levels)))),
        gain=np.ascontiguousarray(gain_from_background(background, change).mean(axis=-1)),
        margin_px=int(np.ceil(2 * change.blur_px)) + BLOOMS_PX,
        outside=outside_of_gel(background),
        gamut=gamut,
        blur_px=change.blur_px,
    )
    cells = None if forward is None else coefficients_of_cells(forward)
    cast = None
    if shadows and cells is not None and forward is not None and forward.shadow_noise is not None:
        cast = CastShadows(cells, forward.shape, forward.shadow_noise, clean)
    return PreparedCauses(limits, cells, background, cast)
