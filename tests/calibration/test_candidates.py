"""Candidates: what a color model's class says is what is tried, and the forward response that each may get a step by."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.calibration.candidates import (
    LEAST_STEP_SIGMA,
    STEP_SIGMAS,
    Candidate,
    FittedSlopes,
    SlopeReader,
    Start,
    candidates_for,
    candidates_from,
    color_model_names,
    fitted_responses,
    start_from,
    starter_note,
    starter_start,
    step_sigma_of,
    training_samples,
    translated,
)
from gelform.calibration.circles.find import ZONE, PreparedPress
from gelform.calibration.starters.starter import load_starter
from gelform.errors import CalibrationError
from gelform.image.background import gain_from_background
from gelform.reconstruct import Reconstructor
from gelform.simulate import Ball, simulate_press
from gelform.slopes.color_models import COLOR_MODELS, ForwardResponse, HierarchicalModel, hierarchical
from gelform.slopes.color_models.forward_response import RIDGES, TERMS
from gelform.slopes.color_models.least_squares import node_positions
from made.images import ball_samples, lambertian_change


def described(color_model, presses):
    return [candidate.describe() for candidate in candidates_for(color_model, presses)]


@pytest.mark.parametrize("presses", [3, 12, 100])
def test_auto_tries_the_ridges_of_one_model(presses):
    """The stiffest first: what is chosen of equals."""
    ridges = [dict(c.settings)["ridge"] for c in candidates_for("auto", presses)]
    assert ridges == sorted(hierarchical.RIDGES, reverse=True)
    assert {c.model for c in candidates_for("auto", presses)} == {"hierarchical"}


@pytest.mark.parametrize("presses", [2, 3, 6, 12, 17, 18, 29, 30, 100])
@pytest.mark.parametrize("name", ["auto", *COLOR_MODELS])
def test_something_is_always_tried(name, presses):
    candidates = candidates_for(name, presses)
    assert candidates
    assert name == "auto" or {c.model for c in candidates} == {name}
    assert {(c.step_ridge, c.start) for c in candidates} == {(None, None)}, "steps are of what was chosen"


def test_the_class_says_what_is_tried(monkeypatch):
    """A model of one's own is tried by its name, in all its variants; auto does not know it."""

    class Mine:
        name, change_offset = "mine", 4.0

        @classmethod
        def variants(cls, presses):
            return [{"strength": 2}, {"strength": presses}]

    monkeypatch.setitem(COLOR_MODELS, "mine", Mine)
    assert described("mine", 40) == ["mine strength 2", "mine strength 40"]
    assert {c.change_offset for c in candidates_for("mine", 40)} == {4.0}
    assert color_model_names() == ["auto", *COLOR_MODELS]
    assert "mine" not in {c.model for c in candidates_for("auto", 40)}


def no_response(shape):
    """A forward response without color: of every slope."""
    rows, columns = (len(at) for at in node_positions(shape))
    return ForwardResponse(np.zeros((rows, columns, TERMS, 3)), np.eye(3), shape)


def test_another_units_model_is_followed_less_and_less():
    """More presses outweigh the other unit; under 12 they do not choose by how much."""
    model = HierarchicalModel.fit(ball_samples(lambertian_change))
    start = Start(model, no_response(model.shape), "digest", 0.1, "another")
    ridges = [dict(c.settings)["ridge"] for c in candidates_from(start, 12)]
    assert ridges == sorted(ridges, reverse=True)
    assert len(ridges) == 3
    assert {c.start for c in candidates_from(start, 12)} == {start}
    assert {c.model for c in candidates_from(start, 12)} == {"hierarchical"}
    (few,) = candidates_from(start, 4)
    assert dict(few.settings)["ridge"] == pytest.approx(3 * ridges[0])
    assert [one.step_ridge for one in few.with_steps(4)] == [pytest.approx(3 * ridges[0])]
    assert not few.may_not_step(4)
    assert few.may_not_step(12)


def test_a_fit_begins_at_the_other_units_model_where_there_is_one():
    """Slopes of which the other unit's model reads half: followed closely, and not at all."""
    samples = ball_samples(lambertian_change)
    whole = HierarchicalModel.fit(samples)
    half = replace(whole, nodes=0.5 * whole.nodes)
    start = Start(half, no_response(whole.shape), "digest", 0.1, "another")
    held = replace(candidates_from(start, 6)[0], settings=(("ridge", 1e6),)).fit(samples)
    np.testing.assert_allclose(held.nodes, start.model.nodes, atol=1e-3)
    alone = candidates_for("hierarchical", 6)[-1].fit(samples)
    ratio = np.vdot(alone.nodes, whole.nodes) / np.vdot(whole.nodes, whole.nodes)
    assert ratio == pytest.approx(1, abs=0.05)


def test_a_candidate_says_its_settings_and_its_step():
    candidate = Candidate("polynomial", (("position_degrees", (2, 1)),))
    assert candidate.describe() == "polynomial 2-1"
    assert replace(candidate, step_ridge=3e-5).describe() == "polynomial 2-1 step 3e-05"
    assert candidate.change_offset == COLOR_MODELS["polynomial"].change_offset
    assert Candidate("lambertian").change_offset == 0


@pytest.fixture(scope="module")
def some(prepared, found):
    chosen = range(0, len(prepared), 2)
    return [prepared[i] for i in chosen], [found[i] for i in chosen]


def test_what_trains_is_inside_the_edge_or_far_off(some):
    presses, contacts = some
    samples = training_samples(presses, contacts, total=4000)
    pressed = samples.gradients.any(axis=1)
    places = np.stack([samples.x_px, samples.y_px], axis=1)[:, None]
    away = np.linalg.norm(places - [(c.x_px, c.y_px) for c in contacts], axis=-1)
    edges = [ZONE * p.contact_radius(c) for p, c in zip(presses, contacts)]
    assert (away < edges).any(axis=1)[pressed].all()
    assert 0.2 < pressed.mean() < 0.9
    assert samples.depth_px is None


class Reads:
    """A model that reads the slopes that lie in the color change."""

    def gradients_at(self, change, x_px, y_px):
        return change[:, :2]

    def prepare(self, background, shape):
        assert background.shape == (*shape, 3)
        return self

    def gradients_from_color(self, color_change):
        return np.ascontiguousarray(color_change[..., :2]), None


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
    found = step_sigma_of(Reads(), samples_with_errors(at_rest, per_slope, resting))
    assert found[0] == pytest.approx(STEP_SIGMAS * said, rel=0.02)
    assert found[1] == pytest.approx(STEP_SIGMAS * per_slope, rel=0.05, abs=0.01 if at_rest else 1e-9)


def test_a_model_that_errs_at_rest_alone_has_a_prior_at_rest():
    rests = samples_with_errors(0.02, 0.0)
    pressed = rests.gradients.any(axis=1, keepdims=True)
    exact = np.where(pressed, rests.gradients, rests.color_change[:, :2])
    right = replace(rests, color_change=np.concatenate([exact, exact[:, :1]], axis=1))
    assert step_sigma_of(Reads(), right) == pytest.approx((STEP_SIGMAS * 0.02, 0), rel=0.02)


def test_a_response_for_each_ridge_knows_the_depth_that_the_model_reads(some, held_out):
    """The one with the smaller ridge explains more of the presses that it was fitted to."""
    presses, contacts = some
    model = Candidate("hierarchical").fit(training_samples(presses, contacts, total=6000))
    reader = SlopeReader(model, presses[0], held_out.prepared_for(Candidate("polynomial"))[1])
    responses = fitted_responses(reader, presses, contacts, RIDGES[::3], total=6000)
    assert len(responses) == 2
    assert {response.shape for response in responses} == {presses[0].size.shape}
    stiff, free = (np.trace(response.covariance) for response in responses)
    assert free < stiff
    assert all(np.abs(response.nodes[:, :, -3]).max() > 1e-3 for response in responses), "of the depth"


def test_the_responses_step_has_the_prior_of_the_model(some, held_out):
    """By the slopes that train and the untouched gel beside them, where every model is nearly right."""
    presses, contacts = some
    samples = training_samples(presses, contacts, total=6000)
    model = Candidate("polynomial", (("position_degrees", (1,)),)).fit(samples)
    reader = SlopeReader(model, presses[0], held_out.prepared_for(Candidate("polynomial"))[1])
    (response,) = fitted_responses(reader, presses, contacts, RIDGES[:1], total=6000)
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
    reconstruct = Reconstructor(replace(calibration, forward=forward), solver="dct")
    for press, image in zip(prepared[:3], presses.presses):
        read = reader(forward).frame(press)
        apart = reconstruct.from_image(image.image).observed_gradients - read.gradients
        np.testing.assert_allclose(apart, np.broadcast_to(apart[0, 0], apart.shape), atol=1e-5)
        assert np.abs(apart[0, 0]).max() < 0.02
        assert read.variance.shape == read.residual.shape == press.size.shape


def test_without_a_step_nothing_is_stated(calibration, prepared, reader):
    """The deviation is all in the factors that held-out presses tell."""
    for forward in (None, replace(calibration.forward, step_sigma=None)):
        read = reader(forward).frame(prepared[1])
        assert (read.variance == 1).all()
        assert (read.residual == 0).all()
        plain = calibration.color_model.prepare(prepared[1].background, prepared[1].size.shape)
        np.testing.assert_array_equal(read.gradients, plain.gradients_from_color(prepared[1].color_change)[0])


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
    press = PreparedPress("bump", change, np.linalg.norm(change, axis=-1), 40.0, background=background)
    found = SlopeReader(Reads(), press, 0.01).depth_px(press)
    np.testing.assert_allclose(found, depth, atol=0.3)
    assert found.min() == 0


def test_a_translated_model_reads_the_slopes_that_the_first_one_reads(lambertian_calibration, simulated):
    """On the image of a ball that neither has seen: as far from the truth, and near to each other."""
    rng = np.random.default_rng(2)
    press = simulate_press(simulated.sensor, Ball(3.2), depth_mm=0.5, center_mm=(1.0, -1.0), rng=rng)
    model, forward = translated(lambertian_calibration)
    assert isinstance(model, HierarchicalModel)
    x, y, slopes = np.array([40, 100]), np.array([50, 90]), np.array([[0.2, -0.1], [-0.3, 0.2]])
    colors = [one.color_from_gradients(slopes, x, y) for one in (lambertian_calibration.forward, forward)]
    gains = [
        gain_from_background(lambertian_calibration.background, one)[y, x]
        for one in (
            lambertian_calibration.change,
            replace(lambertian_calibration.change, offset=model.change_offset),
        )
    ]
    np.testing.assert_allclose(colors[1], colors[0] * gains[1] / gains[0], rtol=0.02)
    change = replace(lambertian_calibration.change, offset=HierarchicalModel.change_offset)
    own = replace(lambertian_calibration, forward=replace(lambertian_calibration.forward, step_sigma=None))
    other = replace(own, color_model=model, change=change)
    y, x = np.mgrid[: press.image.shape[0], : press.image.shape[1]]
    inside = np.hypot(x - press.center_px[0], y - press.center_px[1]) < 0.8 * press.contact_radius_px
    first, second = (gelform.Reconstructor(one)(press.image).gradients[inside] for one in (own, other))
    assert np.sqrt(np.mean(first**2)) > 0.15
    assert np.sqrt(np.mean((first - second) ** 2)) < 0.04


def test_a_second_unit_starts_from_any_color_model(lambertian_calibration, calibration, presses):
    start = start_from(lambertian_calibration, presses, "auto")
    assert start.digest == lambertian_calibration.digest
    assert start.model.degree == 3, "as the model that is drawn to it"
    np.testing.assert_allclose(
        start_from(calibration, presses, "hierarchical").model.nodes, calibration.color_model.nodes
    )


def test_a_start_of_another_make_is_refused_and_of_another_gel_is_noted(calibration, presses):
    mini, digit = replace(presses, make="gelsight-mini"), replace(calibration, sensor_name="DIGIT 7")
    with pytest.raises(CalibrationError, match="a GelSight Mini, got a calibration of a DIGIT"):
        start_from(digit, mini, "auto")
    old, new = replace(calibration, gel_id="old"), replace(presses, gel_id="new")
    assert start_from(old, new, "auto").note == "The start is of gel old, the presses are of new."
    assert start_from(old, presses, "auto").note == ""


def test_another_unit_s_model_is_read_at_the_same_places_in_mm(calibration, presses):
    """The first unit's pixels are half as wide, so that the whole second image lies in its middle half."""
    first = replace(calibration, mm_per_px=presses.mm_per_px / 2)
    model, own = start_from(first, presses, "auto").model, calibration.color_model
    change = np.float32([[0.2, -0.1, 0.1]])
    height, width = own.shape
    x, y = (np.array([(n - 1) / 2 + part]) for n, part in ((width, 9), (height, 7)))
    wider = own.gradients_at(change, x + 9, y + 7)
    np.testing.assert_allclose(model.gradients_at(change, x, y), wider, rtol=0.1, atol=5e-3)


def test_the_noise_of_colors_is_that_of_the_response(lambertian_calibration, monkeypatch):
    """Alike channels stay alike: the covariance, not a deviation of each."""
    drawn = []
    covariance = 1e-4 * np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 0.25]])
    forward = replace(lambertian_calibration.forward, step_sigma=None, covariance=covariance)
    hardly = replace(lambertian_calibration.slope_sigma, shown=(0.0, 1e-6))
    first = replace(lambertian_calibration, forward=forward, slope_sigma=hardly)
    plain = type(first.color_model).gradients_at

    def read(self, change, x, y):
        drawn.append(change)  # of no slope: all of it is noise
        return plain(self, change, x, y)

    monkeypatch.setattr(type(first.color_model), "gradients_at", read)
    translated(first)
    np.testing.assert_allclose(np.cov(drawn[0].T), covariance, atol=1e-5)


def test_a_start_without_a_forward_response_or_of_another_size_is_refused(lambertian_calibration, presses):
    with pytest.raises(CalibrationError, match="what color a slope gives"):
        start_from(replace(lambertian_calibration, forward=None), presses, "auto")
    with pytest.raises(ValueError, match="132x176 px, got one for 10x20 px"):
        start_from(replace(lambertian_calibration, image_shape=(10, 20)), presses, "auto")


def test_the_make_brings_the_starter_whatever_the_sensor_is_called(presses):
    light = load_starter("gelsight-mini").calibration.background
    mine = replace(presses, background=light, mm_per_px=0.0634, sensor_name="my Mini")
    assert starter_start(mine, "auto") is None
    assert "GelSight Mini" in starter_start(replace(mine, make="gelsight-mini"), "auto").by
    assert starter_start(replace(mine, make="digit"), "auto") is None
    mini = replace(mine, make="gelsight-mini")
    assert starter_note(mine, "auto") == starter_note(mini, "auto") == ()
    assert starter_note(replace(mine, make="simulated-three-edges"), "auto") == (), "no make that one has"
    (other,) = starter_note(replace(mine, make="digit"), "auto")
    assert (
        "The starter of a DIGIT was not tried, because it is for images of 320x240 px, and these are 240x320"
        in other
    )
    (lookup,) = starter_note(mini, "lookup")
    assert "it is of the color model hierarchical, and lookup was asked for." in lookup
    (strange,) = starter_note(replace(mini, background=mini.background[..., ::-1].copy()), "auto")
    assert strange.startswith("The starter of a GelSight Mini was not tried, because ")
