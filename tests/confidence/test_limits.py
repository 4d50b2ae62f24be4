"""What a calibration says of the causes."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.background.change import ChangeSettings
from gelform.color_models._shared.forward import ForwardResponse
from gelform.confidence.limits import noise_of, prepared_causes


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
    assert of.noise == calibration.forward.held_out_noise >= np.sqrt((calibration.forward.noise**2).mean())
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


def test_the_noise_on_held_out_presses_decides_not_that_of_training():
    """Of five presses a response fits its own presses well, and others badly: then nothing is a sign of anything."""
    trained = ForwardResponse(np.zeros((1, 3)), (0,), (24, 32), np.full(3, 0.006))
    assert noise_of(trained) == pytest.approx(0.006)
    assert noise_of(replace(trained, held_out_noise=0.2)) == 0.2
    assert noise_of(replace(trained, held_out_noise=0.001)) == pytest.approx(0.006)
    with pytest.raises(ValueError, match="held_out_noise"):
        replace(trained, held_out_noise=-1.0)
