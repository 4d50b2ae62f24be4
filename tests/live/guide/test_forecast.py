"""The forecast: near what a calibration on these presses reaches, and better with more of them."""

from gelform.live.guide.forecast import LEAST, forecast_of


def test_it_is_near_what_the_calibration_reaches(presses, calibration):
    found = forecast_of(presses)
    reached = calibration.held_out["normal_free_deg"]
    assert found.presses == len(presses.presses)
    assert (
        0.4 * reached < found.now_deg < 5 * reached
    )  # recorded: 4.6, a polynomial without a step beside one with it
    assert found.more_deg <= found.now_deg


def test_few_presses_say_nothing(presses):
    assert forecast_of(presses.subset(range(LEAST - 1))) is None
