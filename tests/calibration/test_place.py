"""The error of a place, as presses of a ball show it."""

import numpy as np
import pytest

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.place import place_error_from_presses
from gelform.calibration_file import calibration_from_contents


def circles_of(presses, calibration, shift=lambda x, y: (0.0, 0.0)):
    rows = [row for row in calibration.report.presses if row.accepted]
    used = [press for press, row in zip(presses.presses, calibration.report.presses) if row.accepted]
    places = [(row.center_x_px, row.center_y_px, row.contact_radius_px) for row in rows]
    return used, [
        ContactCircle(x + shift(x, y)[0], y + shift(x, y)[1], radius, 0.9, 5.0) for x, y, radius in places
    ]


def test_it_is_small_on_a_simulated_sensor_and_kept_in_the_file(calibration):
    assert 0.0005 < calibration.settings.place_error < 0.03
    assert calibration_from_contents(*calibration.contents()).settings.place_error == pytest.approx(
        calibration.settings.place_error
    )


@pytest.mark.slow
def test_a_wrong_scale_of_the_circles_is_an_error_of_places(presses, calibration):
    """Circles 3 % nearer to the middle: each axis is off by 3 % of the displacement, over the root of two."""
    middle = (np.array(calibration.image_shape[::-1]) - 1) / 2
    nearer = circles_of(presses, calibration, lambda x, y: tuple(-0.03 * (np.array([x, y]) - middle)))
    found, own = place_error_from_presses(calibration, *nearer), calibration.settings.place_error
    assert found == pytest.approx(0.03 / np.sqrt(2), abs=1.5 * own + 0.0015)


def test_few_presses_do_not_show_it(presses, calibration):
    used, circles = circles_of(presses, calibration)
    assert place_error_from_presses(calibration, used[:3], circles[:3]) is None


def test_a_file_with_an_impossible_one_is_refused(calibration):
    arrays, meta = calibration.contents()
    with pytest.raises(ValueError, match="place_error"):
        calibration_from_contents(arrays, {**meta, "settings": {**meta["settings"], "place_error": 2.0}})
