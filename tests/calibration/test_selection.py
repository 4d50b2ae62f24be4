"""Candidates, and the selection among them by presses that were not seen, whatever one of them says.

No press trains what scores it, and no fold's own presses decide what scores them.
"""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration import held_out as held_out_module
from gelform.calibration import selection as module
from gelform.calibration.circles.find import (
    TRIAL_SAMPLES,
    ContactCircle,
    PreparedPress,
    find_contact,
    magnitude,
    training_samples,
)
from gelform.calibration.circles.locate import Located, refine
from gelform.calibration.coverage import FOLDS
from gelform.calibration.held_out import _jackknife, circle_sigmas
from gelform.calibration.selection import (
    LEAST_STEP_SIGMA,
    STEP_SIGMAS,
    Candidate,
    FittedSlopes,
    Fold,
    HeldOutPresses,
    HeldOutSlopeScore,
    SlopeReader,
    Trial,
    average,
    candidates_for,
    candidates_from,
    fitted_responses,
    fold_of,
    make_folds,
    score_of,
    select,
    step_sigma_of,
)
from gelform.calibration.start import Start
from gelform.errors import CalibrationError
from gelform.reconstruct import Reconstructor
from gelform.result.metrics import ball_gradients
from gelform.slopes.color_models import COLOR_MODELS, ForwardResponse, HierarchicalModel
from gelform.slopes.color_models import polynomial as hierarchical
from gelform.slopes.color_models.forward_response import RIDGES, TERMS, Step
from gelform.slopes.color_models.seam import node_positions
from made.images import SlopesAsColors, ball_samples, lambertian_change


@pytest.mark.parametrize("presses", [2, 3, 6, 12, 17, 18, 29, 30, 100])
@pytest.mark.parametrize("name", ["auto", *COLOR_MODELS])
def test_something_is_always_tried(name, presses):
    """What the model's class names; of "auto" the ridges of one model, the stiffest first, which is chosen of equals."""
    candidates, model = candidates_for(name, presses), "hierarchical" if name == "auto" else name
    assert {c.model for c in candidates} == {model}
    assert [dict(c.settings) for c in candidates] == list(COLOR_MODELS[model].variants(presses))
    if name == "auto":
        ridges = [dict(c.settings)["ridge"] for c in candidates]
        assert ridges == sorted(hierarchical.RIDGES, reverse=True)
    assert {(c.step_ridge, c.start) for c in candidates} == {(None, None)}, "steps are of what was chosen"


def start_at(model):
    """Another unit's model, with a forward response without color."""
    rows, columns = (len(at) for at in node_positions(model.shape))
    response = ForwardResponse(np.zeros((rows, columns, TERMS, 3)), np.eye(3), model.shape)
    return Start(model, response, "digest", 0.1, "another")


def test_another_units_model_is_followed_less_and_less():
    """More presses outweigh the other unit; under 12 they do not choose by how much."""
    start = start_at(HierarchicalModel.fit(ball_samples(lambertian_change)))
    ridges = [dict(c.settings)["ridge"] for c in candidates_from(start, 12)]
    assert ridges == sorted(ridges, reverse=True)
    assert len(ridges) == 3
    assert {c.start for c in candidates_from(start, 12)} == {start}
    assert {c.model for c in candidates_from(start, 12)} == {"hierarchical"}
    (few,) = candidates_from(start, 4)
    assert dict(few.settings)["ridge"] == pytest.approx(3 * ridges[0])
    assert [one.step_ridge for one in few.with_steps(4)] == [pytest.approx(3 * ridges[0])]


def test_a_fit_begins_at_the_other_units_model_where_there_is_one():
    """Slopes of which the other unit's model reads half: followed closely, and not at all."""
    samples = ball_samples(lambertian_change)
    whole = HierarchicalModel.fit(samples)
    start = start_at(replace(whole, nodes=0.5 * whole.nodes))
    held = replace(candidates_from(start, 6)[0], settings=(("ridge", 1e6),)).fit(samples)
    np.testing.assert_allclose(held.nodes, start.model.nodes, atol=1e-3)
    alone = candidates_for("hierarchical", 6)[-1].fit(samples)
    ratio = np.vdot(alone.nodes, whole.nodes) / np.vdot(whole.nodes, whole.nodes)
    assert ratio == pytest.approx(1, abs=0.05)


def polynomial(*degrees, step_ridge=None):
    return Candidate("polynomial", (("position_degrees", degrees),), step_ridge=step_ridge)


def test_a_candidate_says_its_settings_and_its_step():
    candidate = polynomial(2, 1)
    assert candidate.describe() == "polynomial 2-1"
    assert polynomial(2, 1, step_ridge=3e-5).describe() == "polynomial 2-1 step 3e-05"
    assert STIFF.describe() == "hierarchical ridge 0.001"
    assert candidate.change_offset == COLOR_MODELS["polynomial"].change_offset
    assert Candidate("lambertian").change_offset == 0


@pytest.fixture(scope="module")
def some(prepared, found):
    chosen = range(0, len(prepared), 2)
    return [prepared[i] for i in chosen], [found[i] for i in chosen]


def samples_with_errors(at_rest, per_slope, resting=0.4):
    """Samples whose color change is their slopes, read off by so much at rest, and by so much more with the slope."""
    samples = ball_samples(lambertian_change, count=20_000)
    rng = np.random.default_rng(1)
    slopes = samples.gradients * (rng.uniform(size=(20_000, 1)) >= resting)
    sigma = np.hypot(at_rest, per_slope * np.linalg.norm(slopes, axis=1, keepdims=True))
    read = slopes + sigma * rng.normal(size=slopes.shape)
    return replace(samples, gradients=slopes, color_change=np.concatenate([read, read[:, :1]], axis=1))


LEAST = LEAST_STEP_SIGMA  # of a model that is right everywhere, and of samples of which none rests


@pytest.mark.parametrize(
    ("at_rest", "per_slope", "resting", "said"),
    [
        *((0.01, 0.1, 0.4, 0.01), (0.02, 0.05, 0.4, 0.02), (0.015, 0.0, 0.4, 0.015)),
        *((0.0, 0.0, 0.4, LEAST), (0.0, 0.1, 0, LEAST)),
    ],
)
def test_a_steps_prior_is_what_the_model_is_off_by(at_rest, per_slope, resting, said):
    """At rest, and more by the slope: a quarter more than on the samples that it was fitted to; never none at all."""
    found = step_sigma_of(SlopesAsColors(), samples_with_errors(at_rest, per_slope, resting))
    assert found[0] == pytest.approx(STEP_SIGMAS * said, rel=0.02)
    assert found[1] == pytest.approx(STEP_SIGMAS * per_slope, rel=0.05, abs=0.01 if at_rest else 1e-9)


def test_a_model_that_errs_at_rest_alone_has_a_prior_at_rest():
    rests = samples_with_errors(0.02, 0.0)
    pressed = rests.gradients.any(axis=1, keepdims=True)
    exact = np.where(pressed, rests.gradients, rests.color_change[:, :2])
    right = replace(rests, color_change=np.concatenate([exact, exact[:, :1]], axis=1))
    assert step_sigma_of(SlopesAsColors(), right) == pytest.approx((STEP_SIGMAS * 0.02, 0), rel=0.02)


def test_a_response_for_each_ridge_knows_the_depth_that_the_model_reads(some, held_out):
    """The one with the smaller ridge explains more of the presses that it was fitted to; all have the prior of the model."""
    samples = training_samples(*some, total=6000)
    model = Candidate("hierarchical").fit(samples)
    reader = SlopeReader(model, some[0][0], held_out.prepared_for(polynomial(1))[1])
    responses = fitted_responses(reader, *some, RIDGES[::3], total=6000)
    assert {response.shape for response in responses} == {some[0][0].size.shape}
    stiff, free = (np.trace(response.covariance) for response in responses)
    assert free < stiff
    assert all(np.abs(response.nodes[:, :, -3]).max() > 1e-3 for response in responses), "of the depth"
    for response in responses:
        assert response.step_sigma == pytest.approx(step_sigma_of(model, samples))
        assert 0.003 < response.step_sigma[0] < 0.03 < response.step_sigma[1] < 0.5


@pytest.fixture(scope="module")
def reader(calibration, prepared):
    """Makes what reads by the calibration's color model and a forward response."""
    one = SlopeReader(calibration.color_model, prepared[0], calibration.untouched_change)
    return lambda forward: FittedSlopes(one, forward)


@pytest.mark.parametrize("step", [True, False])
def test_slopes_are_those_that_a_reconstructor_reads(calibration, presses, prepared, reader, step):
    """Of whole images, with and without the step; but for the bias, which it takes away from all slopes alike."""
    forward = calibration.forward if step else replace(calibration.forward, step_sigma=None)
    reconstruct = Reconstructor(replace(calibration, forward=forward))
    for press, image in zip(prepared[:3], presses.presses):
        read = reader(forward).frame(press)
        apart = reconstruct.from_image(image.image).observed_gradients - read.gradients
        np.testing.assert_allclose(apart, np.broadcast_to(apart[0, 0], apart.shape), atol=1e-5)
        assert np.abs(apart[0, 0]).max() < 0.02
        assert read.variance.shape == read.residual.shape == press.size.shape
        assert step != ((read.variance == 1).all() and (read.residual == 0).all()), "only a step states them"


def test_a_step_changes_slopes_and_states_them(calibration, prepared, reader):
    stepped, plain = (reader(forward).frame(prepared[1]) for forward in (calibration.forward, None))
    assert 1e-3 < np.abs(stepped.gradients - plain.gradients).mean() < 0.1
    at_rest, per_slope = calibration.forward.step_sigma
    prior = at_rest**2 + per_slope**2 * np.sum(np.square(plain.gradients), axis=-1)
    assert stepped.variance.min() > 0
    assert (stepped.variance <= prior * (1 + 1e-4)).all(), "known better than before, wherever it is taken"
    assert stepped.residual.min() >= 0


@pytest.mark.parametrize("background", [None, np.full((90, 120, 3), 80.0, np.float32)])
def test_the_depth_is_that_of_the_slopes_that_the_model_reads(background):
    """A bump of 4 px, in pixels; untouched gel around it is at 0."""
    y, x = np.mgrid[:90, :120].astype(float)
    depth = 4 * np.exp(-((x - 70) ** 2 + (y - 40) ** 2) / 200)
    slopes = np.stack([70 - x, 40 - y], axis=-1) * (depth / 100)[..., None]
    change = np.concatenate([slopes, slopes[..., :1]], axis=-1).astype(np.float32)
    size = np.linalg.norm(change, axis=-1)
    press = PreparedPress("bump", change, size, 40.0, find_contact(change), background=background)
    found = SlopeReader(SlopesAsColors(), press, 0.01).depth_px(press)
    np.testing.assert_allclose(found, depth, atol=0.3)
    assert found.min() == 0


def test_held_out_presses_train_nothing_and_every_fold_has_both_balls(folds, prepared):
    held_out = [i for fold in folds for i in fold.held_out]
    assert sorted(held_out) == list(range(len(prepared)))
    for fold in folds:
        assert not set(fold.held_out) & set(fold.training)
        assert len(fold.contacts) == len(fold.training)
        assert len({prepared[i].ball_radius_px for i in fold.training}) == 2


def test_circles_are_refined_from_the_other_units_model(located, prepared):
    """It is far from what these presses say: slopes half as steep."""
    rows, columns = (len(at) for at in node_positions(prepared[0].size.shape))
    nodes = np.zeros((rows, columns, 19, 2))
    nodes[..., :2, :] = 0.5 * np.array([[0.8, 0.3], [-0.3, 0.8]])
    start, training = HierarchicalModel(nodes, 3, prepared[0].size.shape), range(1, 7)
    fold = fold_of(replace(located, refined_by=start), [0], training)
    own, alone = (refine([prepared[i] for i in training], start=one) for one in (start, None))
    assert fold.contacts == tuple(own.contacts[k] for k in own.accepted)
    assert fold.contacts != tuple(alone.contacts[k] for k in alone.accepted)


def of_some(located, usable):
    """The located presses, of which only some were accepted."""
    reasons = tuple(None if i in usable else "refused" for i in range(len(located.prepared)))
    return replace(located, refined=replace(located.refined, reasons=reasons))


def test_presses_that_were_rejected_are_in_no_fold(located):
    usable = [i for i in range(len(located.prepared)) if i != 4]
    done = []
    folds = make_folds(of_some(located, usable), progress=lambda *step: done.append(step[:2]))
    assert sorted(i for fold in folds for i in fold.held_out) == usable
    assert not any(4 in fold.training for fold in folds)
    assert done == [(k, FOLDS) for k in range(1, FOLDS + 1)]


def test_few_presses_are_left_out_one_by_one_and_have_to_fit_without_each_other(located, monkeypatch):
    usable = list(range(0, len(located.prepared), 2))
    few = replace(of_some(located, usable), notes=("The light is clipped.",))
    folds = make_folds(few)
    assert sorted(fold.held_out for fold in folds) == [(i,) for i in usable]
    assert len(folds) == 7 > FOLDS
    monkeypatch.setattr(
        module, "fold_of", lambda _, held_out, training: Fold(tuple(held_out), (training[0],), ())
    )
    with pytest.raises(CalibrationError, match=r"without .* only 1 of the other 6 do\. The light is clipped"):
        make_folds(few)


def test_jackknife_of_a_mean_is_its_standard_error():
    """Leaving one of n out of a mean at a time: the classical case, known exactly."""
    values = np.random.default_rng(0).normal(size=(40, 3))
    left_out = (values.sum(axis=0) - values) / 39
    center, radius = _jackknife(left_out)
    errors = values.std(axis=0, ddof=1) / np.sqrt(40)
    assert radius == pytest.approx(errors[2])
    assert center == pytest.approx(np.sqrt(np.mean(errors[:2] ** 2)))


def test_sigma_of_a_circle_is_of_the_size_of_its_distance_to_the_truth(located, folds, simulated):
    """Each is known once for each fold that trained on it, and once more by the model that had not seen it."""
    sigma = circle_sigmas(located, folds)
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

    def drawn(press, contact, model):
        return replace(contact, x_px=contact.x_px + 1.0)

    monkeypatch.setattr(held_out_module, "fit_model", lambda *_: None)
    monkeypatch.setattr(held_out_module, "recentered", drawn)
    blank = np.zeros((24, 20), np.float32)
    located = Located(None, [PreparedPress("", blank[..., None], blank, 8.0, CIRCLE)] * 2, None)
    assert circle_sigmas(located, folds) == sigma


PRESSES = 20
STIFF, FREE = (Candidate("hierarchical", (("ridge", ridge),)) for ridge in (1e-3, 1e-5))


def trial(candidate, error):
    """The slope errors of 20 presses, by their numbers."""
    return Trial(candidate, {i: HeldOutSlopeScore(error(i), 60 * error(i)) for i in range(PRESSES)})


class MadeUpPresses:
    """20 presses in 5 folds, press i in fold i % 5, whose errors are given by candidate: what `select` asks of them."""

    def __init__(self, error):
        self.folds = [Fold(tuple(range(f, PRESSES, FOLDS)), tuple(range(16)), ()) for f in range(FOLDS)]
        self.error, self.tried = error, []

    def try_candidates(self, candidates):
        self.tried.append(list(candidates))
        return [trial(one, lambda i, one=one: self.error(one, i)) for one in candidates]


def chosen(error, candidates=(STIFF, FREE)):
    return select(candidates, MadeUpPresses(error)).chosen


def test_the_mean_is_of_logarithms():
    """Of some of the presses, if wanted; of none it says the worst."""
    one = trial(STIFF, lambda i: 0.01 if i % 5 else 0.04)
    assert one.mean_log() == pytest.approx(np.log(0.01) + 0.2 * np.log(4))
    assert one.mean_log(range(0, PRESSES, 5)) == pytest.approx(np.log(0.01))
    assert one.mean_log(range(PRESSES)) == float("inf")


def test_a_press_with_a_wrong_circle_does_not_change_the_choice():
    """It is off by ten times as much as the others, by chance less in the worse model: a mean of errors would take that."""

    def error(candidate, i):
        if i == 7:
            return 1.2 if candidate == FREE else 0.7
        return 0.04 if candidate == FREE else 0.05

    means = [np.mean([error(one, i) for i in range(PRESSES)]) for one in (STIFF, FREE)]
    assert means[0] < means[1], "what is guarded against"
    assert chosen(lambda c, i: error(replace(c, step_ridge=None), i)) == FREE
    assert chosen(lambda candidate, i: 0.05) == STIFF, "of equals the first, the stiffest"
    assert chosen(lambda candidate, i: 0.05, (FREE, STIFF)) == FREE


@pytest.mark.parametrize("best", [None, RIDGES[0], RIDGES[2]])
def test_a_step_is_taken_only_where_held_out_presses_are_read_better_by_it(best):
    def error(candidate, i):
        if candidate.step_ridge is None:
            return 0.04 if candidate == FREE else 0.05
        return 0.03 if candidate.step_ridge == best else 0.045

    assert chosen(error) == replace(FREE, step_ridge=best)


def test_steps_are_tried_of_what_leads_alone():
    """By all presses, or without a fold's; one that steps better but reads worse by itself is not asked."""
    held_out = MadeUpPresses(
        lambda c, i: 0.05 if c.settings == STIFF.settings else 0.02 if c.step_ridge else 0.06
    )
    found = select((STIFF, FREE), held_out)
    assert found.chosen == STIFF
    assert held_out.tried == [[STIFF, FREE], [replace(STIFF, step_ridge=ridge) for ridge in RIDGES]]
    assert [one.candidate for one in found.trials] == [*held_out.tried[0], *held_out.tried[1]]


def test_a_fit_from_a_start_is_averaged_with_one_without():
    """In proportion to their likelihoods on held-out presses; a fold's own do not weigh what scores it."""
    start = start_at(HierarchicalModel(np.zeros((3, 3, 19, 2)), 3, (24, 20)))
    (begun,) = candidates_from(start, 4)
    held_out = MadeUpPresses(lambda c, i: 0.04 * (1 if c.start else 1.5 if first_fold(i) else 0.95))
    found = average([select([one], held_out, averaging=True) for one in (begun, STIFF)], held_out)
    (first, one), (second, other) = found.chosen.parts
    each = PRESSES // FOLDS
    assert second / first == pytest.approx(0.95 ** (-4 * each) * 1.5**-each)
    assert first + second == pytest.approx(1)
    assert (one.start, other.start) == (start, None)
    assert (one.step_ridge, other.step_ridge) == (begun.with_steps(PRESSES)[0].step_ridge, RIDGES[0])
    shares = [fold.parts[1][0] for fold in found.by_fold]
    assert shares[0] / (1 - shares[0]) == pytest.approx(0.95 ** (-4 * each))
    assert shares[1:] == pytest.approx([shares[1]] * 4)
    assert shares[1] < second < shares[0]
    assert {found.chosen} <= {trial.candidate for trial in found.trials}


def test_each_fold_averages_what_its_own_presses_do_not_select():
    """From either side the best with a step, though it reads better without one: an average has the responses of both."""
    start = start_at(HierarchicalModel(np.zeros((3, 3, 19, 2)), 3, (24, 20)))
    softest = candidates_from(start, PRESSES)[-1].settings

    def error(candidate, i):
        odd = candidate.settings in (softest, FREE.settings)
        return (0.05 if candidate.step_ridge else 0.01) * (0.2 if first_fold(i) else 1.1) ** odd

    held_out = MadeUpPresses(error)
    sides = [
        select(group, held_out, averaging=True) for group in (candidates_from(start, PRESSES), (STIFF, FREE))
    ]
    found = average(sides, held_out)
    assert [part.settings for _, part in found.chosen.parts] == [softest, FREE.settings]
    assert softest not in [part.settings for _, part in found.by_fold[0].parts]
    assert all(part.step_ridge for one in (found.chosen, *found.by_fold) for _, part in one.parts)


def test_the_mean_of_two_fits_lies_between_them_and_knows_their_distance(held_out, folds, prepared):
    """One reader: of slopes it reads the mean. Its covariance has the distance of the two in it."""
    whole = candidates_for("hierarchical", 12)[0]
    away = replace(
        (model := whole.fit(training_samples(prepared, held_out.located.refined.contacts))),
        nodes=1.5 * model.nodes,
    )
    start = start_at(away)
    parts = [replace(candidates_from(start, 4)[0], step_ridge=1.0), replace(whole, step_ridge=RIDGES[0])]
    both = replace(parts[0], parts=tuple(zip((0.25, 0.75), parts)))
    mean, one, other = held_out.fit(folds[0], [both, *parts])
    change, at = np.full((5, 3), 0.1), (np.arange(5), np.arange(5))
    slopes = [fit.reader.model.gradients_at(change, *at) for fit in (mean, one, other)]
    np.testing.assert_allclose(slopes[0], 0.25 * slopes[1] + 0.75 * slopes[2])
    assert not np.allclose(slopes[1], slopes[2])
    covariances = [fit.forward.covariance for fit in (mean, one, other)]
    np.testing.assert_allclose(covariances[0], 0.25 * covariances[1] + 0.75 * covariances[2])
    priors = [fit.forward.step_sigma[0] for fit in (mean, one, other)]
    assert min(priors[1:]) < priors[0] < max(priors[1:])
    assert held_out.try_candidates([both], folds[:1])[0].scores


def first_fold(i):
    return i % FOLDS == 0


def test_folds_choose_without_their_own_presses():
    """The first fold's presses alone speak for the freer model and for a step: it is scored by what has neither."""

    def error(candidate, i):
        odd = (candidate.settings == FREE.settings) + (candidate.step_ridge == RIDGES[1])
        return 0.05 * (0.2 if first_fold(i) else 1.1) ** odd

    said = []
    held_out = MadeUpPresses(error)
    found = select((STIFF, FREE), held_out, progress=lambda done, total, what: said.append((done, total)))
    wanted = replace(FREE, step_ridge=RIDGES[1])
    assert found.chosen == wanted
    assert found.by_fold == (STIFF, *[wanted] * 4)
    assert said == [(1, 2), (2, 2)]
    assert {found.chosen, *found.by_fold} <= {one.candidate for one in found.trials}


def test_scores_are_those_of_models_that_have_not_seen_the_press(held_out, folds, prepared):
    plain, stepped = polynomial(2, 1), polynomial(2, 1, step_ridge=RIDGES[0])
    of_plain, of_stepped = held_out.try_candidates([plain, stepped])
    assert (of_plain.candidate, of_stepped.candidate) == (plain, stepped)
    assert set(of_plain.scores) == set(of_stepped.scores) == set(range(len(prepared)))
    fold, untouched = folds[0], held_out.prepared_for(plain)[1]
    training = [prepared[i] for i in fold.training]
    model = plain.fit(training_samples(training, fold.contacts, total=TRIAL_SAMPLES))
    reader = SlopeReader(model, prepared[0], untouched)
    (forward,) = fitted_responses(reader, training, fold.contacts, [RIDGES[0]], total=TRIAL_SAMPLES)
    for trial_, response in ((of_plain, None), (of_stepped, forward)):
        for i in fold.held_out:
            frame = FittedSlopes(reader, response).frame(prepared[i])
            assert trial_.scores[i] == score_of(prepared[i], frame)
    assert of_plain.scores != of_stepped.scores


def test_each_candidate_is_fitted_once_for_each_fold(located, folds, monkeypatch):
    """And all its steps with the model of the one without."""
    fits = []
    plain_fit = Candidate.fit
    monkeypatch.setattr(Candidate, "fit", lambda self, samples: fits.append(self) or plain_fit(self, samples))
    own = HeldOutPresses(located, folds[:2])
    candidate = polynomial(1)
    steps = [replace(candidate, step_ridge=ridge) for ridge in RIDGES[:2]]
    first = own.try_candidates([candidate])
    own.try_candidates(steps)
    assert own.try_candidates([candidate]) == first
    assert [replace(one, step_ridge=None) for one in fits] == [candidate] * 2
    (reader, forward), *stepped = own.fit(folds[0], [candidate, *steps])
    assert forward is None
    assert all(one is reader for one, _ in stepped)
    assert len({id(response) for _, response in stepped}) == 2


def test_scores_are_the_errors_that_were_put_in():
    """Inside the contact's edge, whatever lies beyond; the center is free."""
    rows, cols = np.mgrid[:90, :120]
    slopes = ball_gradients(cols, rows, (61.0, 44.0), 40.0)
    away = np.hypot(cols - 61, rows - 44)
    slopes[away > 18] = 0.0  # the gel has left the ball
    change = np.concatenate([slopes, slopes[..., :1]], axis=-1).astype(np.float32)
    contact = ContactCircle(61.4, 43.8, 25.0, 1.0, 9.0)
    press = PreparedPress("one", change, magnitude(change), 40.0, contact, contact_radius_ratio=0.7)
    exact, steep = (score_of(press, Step(factor * slopes, None, None)) for factor in (1.0, 1.1))
    assert exact.slope_error < 1e-4
    assert exact.normal_deg < 0.01
    inside = np.linalg.norm(slopes[away < 0.7 * 25], axis=-1)
    assert steep.slope_error == pytest.approx(0.1 * np.sqrt(np.mean(inside**2)), rel=0.05)
    assert 0.5 < steep.normal_deg < 2
    blind = score_of(press, Step(0 * slopes, None, None))
    assert blind.slope_error == pytest.approx(np.sqrt(np.mean(inside**2)), rel=0.1)
