"""Folds: no press trains what scores it, and another unit's model counts where it is left out too."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.locate import Located, Refined, refine
from gelform.calibration.enough import FOLDS
from gelform.calibration.held_out import folds as module
from gelform.calibration.held_out.folds import Fold, _jackknife, check_folds, circle_sigmas, make_folds
from gelform.errors import CalibrationError
from gelform.slopes.color_models import HierarchicalModel


@pytest.fixture(scope="module")
def start(calibration):
    """Another unit's model, far from what these presses say: slopes half as steep."""
    shape = calibration.image_shape
    rows, columns = (-(-(n - 1) // 16) + 1 for n in shape)
    nodes = np.zeros((rows, columns, 19, 2))
    nodes[..., :2, :] = 0.5 * np.array([[0.8, 0.3], [-0.3, 0.8]])
    return HierarchicalModel(nodes, 3, shape)


def test_held_out_presses_train_nothing_and_every_fold_has_both_balls(folds, prepared):
    held_out = [i for fold in folds for i in fold.held_out]
    assert sorted(held_out) == list(range(len(prepared)))
    for fold in folds:
        assert not set(fold.held_out) & set(fold.training)
        assert len(fold.contacts) == len(fold.training)
        assert len({prepared[i].ball_radius_px for i in fold.training}) == 2


@pytest.mark.slow
def test_circles_are_refined_from_the_other_units_model(prepared, found, start):
    fold = make_folds(prepared, found, range(len(prepared)), start=start)[0]
    training = [i for i in range(len(prepared)) if i not in fold.held_out]
    training.sort(key=lambda i: prepared[i].ball_radius_px)
    own = refine([prepared[i] for i in training], [found[i] for i in training], start=start)
    assert fold.contacts == tuple(own.contacts[k] for k in own.accepted)
    alone = refine([prepared[i] for i in training], [found[i] for i in training])
    assert fold.contacts != tuple(alone.contacts[k] for k in alone.accepted)


def test_presses_that_were_rejected_are_in_no_fold(prepared, found):
    usable = [i for i in range(len(prepared)) if i != 4]
    done = []
    folds = make_folds(prepared, found, usable, progress=lambda *step: done.append(step[:2]))
    assert sorted(i for fold in folds for i in fold.held_out) == usable
    assert not any(4 in fold.training for fold in folds)
    assert done == [(k, FOLDS) for k in range(1, FOLDS + 1)]


def test_few_presses_are_left_out_one_by_one_and_have_to_fit_without_each_other(presses, prepared, found):
    usable = list(range(0, len(prepared), 2))
    folds = make_folds(prepared, found, usable)
    assert sorted(fold.held_out for fold in folds) == [(i,) for i in usable]
    assert len(folds) == 7 > FOLDS
    refined = Refined(tuple(found), (None,) * len(found), None)
    located = Located(presses, prepared, found, refined, notes=("The light is clipped.",))
    check_folds(located, folds)
    alone = [Fold((usable[0],), (usable[1],), (found[usable[1]],)), *folds[1:]]
    expected = f"without {presses.presses[0].name} only 1 of the other .* The light is clipped"
    with pytest.raises(CalibrationError, match=expected):
        check_folds(located, alone)


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


CIRCLE = ContactCircle(10.0, 12.0, 5.0, 0.9, 9.0)
# Where it trains a circle stays, where it is left out it is drawn on by 5 px: of two, half of the difference.
DRAWN = pytest.approx((np.sqrt(25 / 4 / 2), 0))


@pytest.mark.parametrize(
    ("folds", "sigma"),
    [
        ([Fold((0,), (1,), (CIRCLE,)), Fold((1,), (0,), (CIRCLE,))], {0: DRAWN, 1: DRAWN}),
        ([Fold((), (0,), (CIRCLE,))], {}),  # known once
        ([Fold((), (0, 1), (CIRCLE, CIRCLE))] * 3, {0: (0.0, 0.0), 1: (0.0, 0.0)}),  # none moves
    ],
)
def test_a_press_that_is_left_out_is_placed_by_the_others(monkeypatch, folds, sigma):
    """By a model that has not seen it, which draws its circle 1 px to the right whenever it is asked."""

    def drawn(press, contact, found, model):
        return replace(contact, x_px=contact.x_px + 1.0)

    monkeypatch.setattr(module, "fit_model", lambda *_: None)
    monkeypatch.setattr(module, "recentered", drawn)
    assert circle_sigmas([None, None], [CIRCLE, CIRCLE], folds) == sigma
