"""What a calibration says of the causes."""

import numpy as np
import pytest

from gelform.background.change import ChangeSettings
from gelform.confidence.limits import prepared_causes, well_trained


def test_the_figures_of_a_calibration(calibration):
    causes = prepared_causes(
        calibration.background,
        calibration.change,
        clean=0.04,
        levels=[1.0, 2.0, 2.0],
        gamut=calibration.gamut,
        forward=calibration.forward,
    )
    of = causes.limits
    assert of.worth == calibration.gamut.slope_per_change
    assert of.noise == pytest.approx(np.sqrt((calibration.forward.noise**2).mean()))
    assert of.levels == pytest.approx(3**0.5)
    assert of.margin_px == np.ceil(2 * calibration.change.blur_px) + 1
    assert of.gain[3, 4] == pytest.approx((1 / (calibration.background[3, 4] + 10)).mean(), rel=1e-5)
    assert of.outside is None


def test_what_is_not_known():
    background = np.full((24, 32, 3), 60, np.float32)
    background[:10, :10] = 1
    causes = prepared_causes(background, ChangeSettings(), clean=0.04, levels=None, gamut=None, forward=None)
    assert causes.limits.noise is None
    assert causes.limits.worth == 1
    assert causes.limits.levels == np.inf
    assert causes.limits.outside.sum() == 100


def test_the_forward_response_of_few_presses_is_not_asked(calibration):
    assert well_trained(calibration.forward, 11) is None
    assert well_trained(calibration.forward, 12) is calibration.forward
