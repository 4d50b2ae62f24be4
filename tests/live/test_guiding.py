"""The buttons of the guided calibration: what they refuse, in words."""

import pytest

from gelform.errors import GelformError
from gelform.live import guiding


@pytest.mark.parametrize("diameter", [0.0, -3.0, 1e4])
def test_a_ball_of_no_size_is_refused(hub, diameter):
    with pytest.raises(GelformError, match="ball"):
        guiding.start(hub, 0, diameter, "", 0.0)
    assert not hub.guides


def test_without_a_guide_there_is_nothing_to_fit_or_use(hub):
    for act in (guiding.fit, guiding.use):
        with pytest.raises(GelformError, match="Start one"):
            act(hub, 0)


def test_the_simulated_sensor_knows_its_scale(hub, sensor):
    guiding.start(hub, 0, 5.0, "", 0.0)
    assert hub.guides[0].guide.asked.mm_per_px == sensor.mm_per_px
    guiding.start(hub, 0, 6.0, "", 0.0)
    assert hub.guides[0].guide.asked.ball_diameter_mm == 6.0
    assert len(hub.stations[0].taps) == 1
