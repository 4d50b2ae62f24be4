"""Folds: no press trains what scores it, and another unit's model counts where it is left out too."""

import numpy as np
import pytest

from gelform.calibration.circles.refine import refine
from gelform.calibration.selection.folds import FOLDS, make_folds
from gelform.color_models import HierarchicalModel


@pytest.fixture(scope="module")
def start(calibration):
    """Another unit's model, far from what these presses say: slopes half as steep."""
    shape = calibration.image_shape
    rows, columns = (-(-(n - 1) // 16) + 1 for n in shape)
    nodes = np.zeros((rows, columns, 19, 2))
    nodes[..., :2, :] = 0.5 * np.array([[0.8, 0.3], [-0.3, 0.8]])
    return HierarchicalModel(nodes, 3, shape)


def test_held_out_presses_train_nothing(folds, prepared):
    held_out = [i for fold in folds for i in fold.held_out]
    assert sorted(held_out) == list(range(len(prepared)))
    for fold in folds:
        assert not set(fold.held_out) & set(fold.training)
        assert len(fold.contacts) == len(fold.training)


def test_every_fold_has_both_balls(folds, prepared):
    for fold in folds:
        assert len({prepared[i].ball_radius_px for i in fold.training}) == 2


def test_presses_that_show_the_same_stay_together(prepared, found):
    """Else a press is judged by a model that has seen it under another name."""
    twice = [*prepared, *prepared[:5]]
    folds = make_folds(twice, [*found, *found[:5]], range(len(twice)))
    assert sorted(i for fold in folds for i in fold.held_out) == list(range(len(twice)))
    for fold in folds:
        for i in range(5):
            assert (i in fold.held_out) == (len(prepared) + i in fold.held_out)


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
