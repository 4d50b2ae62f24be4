"""How well a circle is known: the sigma says what the distance to the truth is."""

import numpy as np
import pytest

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.sigma import _jackknife, circle_sigmas
from gelform.calibration.selection.folds import Fold


def test_jackknife_of_a_mean_is_its_standard_error():
    """Leaving one of n out of a mean at a time: the classical case, known exactly."""
    values = np.random.default_rng(0).normal(size=(40, 3))
    left_out = (values.sum(axis=0) - values) / 39
    center, radius = _jackknife(left_out)
    errors = values.std(axis=0, ddof=1) / np.sqrt(40)
    assert radius == pytest.approx(errors[2])
    assert center == pytest.approx(np.sqrt(np.mean(errors[:2] ** 2)))


def test_sigma_of_a_circle_is_of_the_size_of_its_distance_to_the_truth(calibration, simulated):
    distance, sigma = [], []
    for row, press in zip(calibration.report.presses, simulated.presses):
        if row.accepted:
            off = (row.center_x_px - press.center_px[0], row.center_y_px - press.center_px[1])
            distance.append(np.hypot(*off) / np.sqrt(2))
            sigma.append(row.center_sigma_px)
            assert row.contact_radius_sigma_px > 0
    assert len(sigma) >= 10
    ratio = np.sqrt(np.mean(np.square(distance)) / np.mean(np.square(sigma)))
    assert 0.4 < ratio < 3
    assert np.corrcoef(np.argsort(np.argsort(distance)), np.argsort(np.argsort(sigma)))[0, 1] > 0.1


def test_circles_that_do_not_move_are_known_exactly():
    contact = ContactCircle(10.0, 12.0, 5.0, 0.9, 9.0)
    folds = [Fold((), (0, 1), (contact, contact)) for _ in range(3)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gelform.calibration.circles.sigma.fit_model", lambda *_: None)
        assert circle_sigmas([None, None], [contact, contact], folds) == {0: (0.0, 0.0), 1: (0.0, 0.0)}
