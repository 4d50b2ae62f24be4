"""Trials: no press is scored by a model that has seen it."""

import numpy as np

from gelform.calibration.selection.candidates import Candidate
from gelform.calibration.selection.press_score import press_score
from gelform.calibration.selection.trials import SELECTION_SAMPLES, HeldOutPresses


def test_scores_are_those_of_models_that_have_not_seen_the_press(held_out, folds, prepared, found):
    candidate = Candidate("polynomial", 0.8, (("position_degrees", (2, 1)),))
    other = Candidate("polynomial", 0.8, (("position_degrees", (1,)),))
    trial, beside = held_out.with_pairs(held_out.try_candidates([candidate, other]))
    assert (trial.candidate, beside.candidate) == (candidate, other)
    assert trial.by_fold != beside.by_fold
    model = candidate.fit(
        [prepared[i] for i in folds[0].training], folds[0].contacts, total=SELECTION_SAMPLES
    )
    for i in folds[0].held_out:
        assert trial.by_fold[i] == press_score(prepared[i], found[i], model)
    assert set(trial.by_fold) == set(trial.by_size) == set(range(len(prepared)))
    for f, fold in enumerate(folds):
        assert set(trial.by_pair[f]) == set(range(len(prepared))) - set(fold.held_out)
    pair = folds[2].without(folds[0].held_out)
    model = candidate.fit([prepared[i] for i in pair.training], pair.contacts, total=SELECTION_SAMPLES)
    for i in folds[0].held_out:
        assert trial.by_pair[2][i] == press_score(prepared[i], found[i], model)


def test_a_model_that_saw_the_press_flatters_itself(folds, prepared, found):
    """Why all this: the same candidate scores better on the presses that it was fitted on."""
    candidate = Candidate("polynomial", 0.8, (("position_degrees", (3, 2, 0)),))
    fold = folds[0]
    model = candidate.fit([prepared[i] for i in fold.training], fold.contacts)
    seen = np.median([press_score(prepared[i], found[i], model).normal_deg for i in fold.training])
    trial = HeldOutPresses({10.0: prepared}, found, folds, []).try_candidates([candidate])[0]
    assert seen < np.median([score.normal_deg for score in trial.by_fold.values()])
    assert trial.mean_deg() == np.mean([score.normal_deg for score in trial.by_fold.values()])
    assert np.isnan(trial.mean_deg(by_size=True))


def test_presses_of_a_fold_do_not_count_without_it(made_up):
    trial = made_up("m", lambda i: 1.0 + i, by_size=lambda i: 3.0 + i)
    np.testing.assert_array_equal(trial.fold_losses(without=range(2, 20)), [1.0, 2.0])
    np.testing.assert_array_equal(trial.zone_losses(without=range(2, 20)), [2.0, 3.0])
    assert trial.losses_without(0).size == 16
    assert 1.0 not in trial.losses_without(0)
    assert trial.size_ratio(without_fold=0) == np.mean(3.0 + np.array([i for i in range(20) if i % 5])) / (
        np.mean(1.0 + np.array([i for i in range(20) if i % 5]))
    )


def test_without_a_size_left_out_nothing_is_said_against_a_model(made_up):
    assert made_up("m", lambda i: 1.0).size_ratio() == 1
