"""Holding out: no press is scored by a model that has seen it."""

import numpy as np
import pytest

from gelform.calibration.fit import prepare
from gelform.calibration.presses import find_contact
from gelform.calibration.select import Candidate, candidates_for, make_folds, normal_error_deg, score


@pytest.fixture(scope="module")
def prepared(presses):
    return prepare(presses, 10.0)


@pytest.fixture(scope="module")
def found(prepared):
    return [find_contact(press.color_change) for press in prepared]


@pytest.fixture(scope="module")
def folds(prepared, found):
    return make_folds(prepared, found, range(len(prepared)))


def test_held_out_presses_train_nothing(folds, prepared):
    held_out = [i for fold in folds for i in fold.held_out]
    assert sorted(held_out) == list(range(len(prepared)))
    for fold in folds:
        assert not set(fold.held_out) & set(fold.training)
        assert len(fold.contacts) == len(fold.training)


def test_every_fold_has_both_balls(folds, prepared):
    for fold in folds:
        assert len({prepared[i].ball_radius_px for i in fold.training}) == 2


def test_scores_are_those_of_the_folds_own_models(folds, prepared, found):
    candidate = Candidate("polynomial", 0.8, (("position_degrees", (2, 1)),))
    scored = score(candidate, folds, prepared, found)
    model = candidate.fit([prepared[i] for i in folds[0].training], folds[0].contacts)
    again = [normal_error_deg(prepared[i], found[i], model) for i in folds[0].held_out]
    np.testing.assert_allclose(scored.errors_deg[: len(again)], again)
    assert len(scored.errors_deg) == len(prepared)
    assert scored.standard_error_deg > 0


def test_a_model_that_saw_the_press_flatters_itself(folds, prepared, found):
    """Why all this: the same candidate scores better on the presses that it was fitted on."""
    candidate = Candidate("polynomial", 0.8, (("position_degrees", (3, 2, 0)),))
    fold = folds[0]
    model = candidate.fit([prepared[i] for i in fold.training], fold.contacts)
    seen = np.median([normal_error_deg(prepared[i], found[i], model) for i in fold.training])
    assert seen < np.median(score(candidate, folds, prepared, found).errors_deg)


def test_few_presses_try_few_terms():
    assert [c.describe() for c in candidates_for("auto", 6)] == [
        "lambertian, zone 0.8",
        "polynomial 1, zone 0.8",
        "polynomial 2-1, zone 0.8",
    ]
    assert candidates_for("polynomial", 40)[-1].describe() == "polynomial 4-3-1, zone 0.8"
