"""How well a circle is known: the sigma says what the distance to the truth is."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.circles import sigma as module
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


def test_sigma_of_a_circle_is_of_the_size_of_its_distance_to_the_truth(prepared, found, folds, simulated):
    """Each is known once for each fold that trained on it, and once more by the model that had not seen it."""
    sigma = circle_sigmas(prepared, found, folds)
    assert set(sigma) == {i for fold in folds for i in fold.held_out}
    circles = {i: circle for fold in folds for i, circle in zip(fold.training, fold.contacts)}
    distance, known = [], []
    for i, circle in circles.items():
        off = np.subtract((circle.x_px, circle.y_px), simulated.presses[i].center_px)
        distance.append(np.hypot(*off) / np.sqrt(2))
        known.append(sigma[i][0])
        assert sigma[i][1] > 0
    assert len(known) >= 10
    ratio = np.sqrt(np.mean(np.square(distance)) / np.mean(np.square(known)))
    assert 0.4 < ratio < 3


class Drawn:
    """A model that has not seen a press, and draws its circle 1 px to the right whenever it is asked."""

    def __call__(self, press, contact, found, model):
        return replace(contact, x_px=contact.x_px + 1.0)


def test_a_press_that_is_left_out_is_placed_by_the_others(monkeypatch):
    monkeypatch.setattr(module, "fit_model", lambda *_: None)
    monkeypatch.setattr(module, "recentered", Drawn())
    contact = ContactCircle(10.0, 12.0, 5.0, 0.9, 9.0)
    folds = [Fold((0,), (1,), (contact,)), Fold((1,), (0,), (contact,))]
    sigma = circle_sigmas([None, None], [contact, contact], folds)
    # where it trains it stays, where it is left out it is drawn on by 4 px: of two, half of the difference
    assert sigma == {0: pytest.approx((np.sqrt(16 / 4 / 2), 0)), 1: pytest.approx((np.sqrt(16 / 4 / 2), 0))}


def test_of_a_circle_that_is_known_once_nothing_is_said(monkeypatch):
    monkeypatch.setattr(module, "fit_model", lambda *_: None)
    contact = ContactCircle(10.0, 12.0, 5.0, 0.9, 9.0)
    assert circle_sigmas([None], [contact], [Fold((), (0,), (contact,))]) == {}


def test_circles_that_do_not_move_are_known_exactly(monkeypatch):
    contact = ContactCircle(10.0, 12.0, 5.0, 0.9, 9.0)
    folds = [Fold((), (0, 1), (contact, contact)) for _ in range(3)]
    monkeypatch.setattr(module, "fit_model", lambda *_: None)
    assert circle_sigmas([None, None], [contact, contact], folds) == {0: (0.0, 0.0), 1: (0.0, 0.0)}
