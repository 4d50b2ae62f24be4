"""Folds: no press trains what scores it, sizes are left out whole, another unit's model counts everywhere."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.circles.refine import refine
from gelform.calibration.selection import folds as module
from gelform.calibration.selection.folds import make_folds, size_folds, unlike_the_others
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


def test_a_size_that_is_left_out_is_not_in_the_training(sizes, prepared):
    assert len(sizes) == 2
    for fold in sizes:
        trained = {prepared[i].ball_radius_px for i in fold.training}
        assert not trained & {prepared[i].ball_radius_px for i in fold.held_out}


def test_presses_that_show_the_same_stay_together(prepared, found):
    """Else a press is judged by a model that has seen it under another name."""
    twice = [*prepared, *prepared[:5]]
    folds = make_folds(twice, [*found, *found[:5]], range(len(twice)))
    assert sorted(i for fold in folds for i in fold.held_out) == list(range(len(twice)))
    for fold in folds:
        for i in range(5):
            assert (i in fold.held_out) == (len(prepared) + i in fold.held_out)


def test_no_size_is_left_out_where_the_others_are_few(prepared, found):
    assert size_folds(prepared, found, range(len(prepared))) == []


def test_two_folds_left_out(folds):
    pair = folds[0].without(folds[1].held_out)
    assert not set(pair.training) & (set(folds[0].held_out) | set(folds[1].held_out))
    assert pair.held_out == folds[1].held_out
    assert len(pair.contacts) == len(pair.training)


@pytest.mark.parametrize("make", [make_folds, size_folds])
def test_circles_are_refined_from_the_other_units_model(make, prepared, found, start, monkeypatch):
    monkeypatch.setattr(module, "MIN_OF_OTHER_SIZES", 7)
    fold = make(prepared, found, range(len(prepared)), start=start)[0]
    training = [i for i in range(len(prepared)) if i not in fold.held_out]
    training.sort(key=lambda i: prepared[i].ball_radius_px)
    own = refine([prepared[i] for i in training], [found[i] for i in training], start=start)
    assert fold.contacts == tuple(own.contacts[k] for k in own.accepted)
    alone = refine([prepared[i] for i in training], [found[i] for i in training])
    assert fold.contacts != tuple(alone.contacts[k] for k in alone.accepted)


def test_presses_are_judged_by_the_other_units_model(folds, prepared, found, start, monkeypatch):
    """What judges them is fitted from the start, too: with few presses it says most of what there is to say."""
    monkeypatch.setattr(module, "MIN_TO_JUDGE", len(prepared))
    starts = []
    fit = module.fit_model
    monkeypatch.setattr(module, "fit_model", lambda *given: starts.append(given[2]) or fit(*given))
    unlike_the_others(prepared, found, folds, start=start)
    assert starts == [start] * len(folds)


def test_a_press_under_the_name_of_another_ball_is_found(folds, prepared, found, monkeypatch):
    monkeypatch.setattr(module, "MIN_TO_JUDGE", 1)
    given = list(prepared)
    given[5] = replace(given[5], ball_radius_px=2 * given[5].ball_radius_px)
    odd = unlike_the_others(given, found, [fold for fold in folds if 5 in fold.held_out])
    assert list(odd) == [5]
    assert "or its ball_diameter_mm is wrong" in odd[5]


def test_few_presses_judge_nobody(folds, prepared, found):
    assert unlike_the_others(prepared, found, folds) == {}
