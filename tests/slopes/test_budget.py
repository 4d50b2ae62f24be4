"""The budget of slopes: each row by itself, what is weighed, and what presses have not shown. Slopes that a ball in the
frame shows: exact balls, readings that bend, and what is no ball.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import edges_of_cube
import gelform
from gelform.calibration.starters import load_starter
from gelform.foundations.filters import MIN_UNTOUCHED
from gelform.image.background import ChangeSettings, PreparedBackground, gain_from_background
from gelform.result.metrics import ball_gradients
from gelform.simulate import Ball, BoxEdge, Placed, Several, simulate_press
from gelform.slopes import budget
from gelform.slopes.budget import (
    DIFFERENCE_FROM,
    ERROR_OF_DIFFERENCE,
    FOLLOWED,
    GEL_RADII,
    LEAST_WEIGHT,
    OUTLIER,
    PER_EXCESS,
    STEEPEST_FACE,
    USUAL_LEVELS,
    PreparedBudget,
    ReadSlopes,
    names_in_budget,
    noise_at_rest,
    slopes_of_ball,
    without_bias,
)
from gelform.slopes.gradients import STEEPEST_GEL
from gelform.slopes.sigma import SlopeSigma
from kernel_agreement import assert_kernel_agrees
from made.images import PATCHED as SHAPE
from made.images import patch

CLEAN = 0.05
LAW = SlopeSigma(
    rest=0.01, per_step=0.03, per_slope=2.0, solved_factor=0.8, shown=(0.3, 0.5), full_confidence_sigma=CLEAN,
    correlation_px=8.0,
)  # fmt: skip
CHANGE = ChangeSettings(blur_px=1.25)  # compared with slopes 2 px away
GRAY = np.full((*SHAPE, 3), 100, np.float32)


def slopes_of(size=0.0, at_rest=False, **more):
    """Slopes of that size along x, or maps (H, W, 2); what else is known of them."""
    gradients = np.zeros((*SHAPE, 2), np.float32)
    gradients[..., slice(2) if np.ndim(size) == 3 else 0] = size
    return ReadSlopes(gradients, np.full(SHAPE, at_rest), **more)


def prepared(law=LAW, background=GRAY, **settings):
    noise = np.full(background.shape[:2], 4e-4, np.float32)
    return PreparedBudget(law, noise, PreparedBackground(background, CHANGE), **settings)


@pytest.mark.parametrize("size", [0.0, 0.2, 0.5])
def test_the_law_is_the_step_s_and_grows_with_the_slope(size):
    variance = np.random.default_rng(0).uniform(0.3, 3, SHAPE).astype(np.float32)
    found = prepared()(slopes_of(size, variance=variance))
    law = 0.03 * np.sqrt(1 + (2 * size) ** 2)
    np.testing.assert_allclose(found.read, law * np.sqrt(variance), rtol=1e-5)
    np.testing.assert_allclose(found.solved, 0.8 * found.read, rtol=1e-5)
    np.testing.assert_allclose(prepared()(slopes_of(size)).read, law, rtol=1e-5)  # without a step


def test_gel_at_rest_has_the_deviation_of_its_place():
    law = replace(LAW, rest_per_noise=0.5)
    found = prepared(law)(slopes_of(at_rest=True, variance=np.ones(SHAPE, np.float32)))
    np.testing.assert_allclose(found.read, np.sqrt(0.01**2 + 0.25 * 4e-4), rtol=1e-5)


def test_rows_add_up_in_squares():
    rng = np.random.default_rng(1)
    slopes = slopes_of(
        rng.uniform(-0.4, 0.4, (*SHAPE, 2)), residual=rng.exponential(6, SHAPE).astype(np.float32),
        variance=rng.uniform(0.5, 2, SHAPE).astype(np.float32), unseen=patch(),
    )  # fmt: skip
    made = prepared(spread=0.1, carried=0.5, slope_per_change=1.5)
    light = rng.uniform(0, 0.02, SHAPE).astype(np.float32)
    found = made(slopes, 3.0, light, rows=True)
    rows = {name: one.astype(float) for name, one in found.rows.items()}
    law = prepared(walls=False)(replace(slopes, residual=None, unseen=None)).read
    np.testing.assert_allclose(rows["law"], law, rtol=1e-5)
    np.testing.assert_allclose(rows["unseen"], np.where(patch(), CLEAN / LEAST_WEIGHT**0.5, 0), rtol=1e-5)
    np.testing.assert_array_equal(rows["light"], light)
    np.testing.assert_allclose(rows["unit"], 0.1 * np.linalg.norm(slopes.gradients, axis=-1), rtol=1e-5)
    read = np.sqrt(sum(np.square(one) for name, one in rows.items() if name not in ("unit", "steep")))
    np.testing.assert_allclose(found.read, read, rtol=1e-4)
    np.testing.assert_allclose(found.steep, rows["steep"])
    whole = read**2 + np.square(found.steep) + np.square(rows["unit"])
    np.testing.assert_allclose(found.confidence, np.minimum(1, CLEAN**2 / whole), rtol=1e-3)
    solved = np.sqrt(np.minimum(0.64 * read**2, STEEPEST_GEL**2) + np.square(rows["unit"]))
    np.testing.assert_allclose(found.solved, solved, rtol=1e-4)
    np.testing.assert_allclose(found.gradients_sigma[..., 1], np.hypot(found.solved, found.steep), rtol=1e-5)
    assert all(one.any() for one in rows.values())
    plain = made(slopes, 3.0, light)  # asking why changes nothing
    assert not plain.rows
    np.testing.assert_array_equal(plain.confidence, found.confidence)


def test_a_weight_says_no_slope_here_and_nothing_else():
    residual = np.tile(np.linspace(0, 4 * OUTLIER, SHAPE[1], dtype=np.float32), (SHAPE[0], 1))
    slopes = slopes_of(0.9, residual=residual, unseen=patch())
    weight = slopes.weights(CLEAN)
    off = STEEPEST_GEL * np.maximum(2 * residual / OUTLIER - 1, 0)
    wanted = np.where(patch(), LEAST_WEIGHT, CLEAN**2 / (CLEAN**2 + off**2))
    np.testing.assert_allclose(weight, wanted, rtol=1e-4)
    found = prepared()(slopes, rows=True)
    np.testing.assert_allclose(found.rows["outlier"], np.where(patch(), 0, off), atol=1e-5)


def test_a_model_s_own_deviation_counts_where_it_is_larger():
    own = np.full(SHAPE, 0.04, np.float32)
    own[patch()] = 0.3
    slopes = slopes_of(0.5, model_sigma=own)
    np.testing.assert_allclose(prepared()(slopes).read, np.maximum(own, 0.03 * 2**0.5), rtol=1e-5)
    np.testing.assert_allclose(slopes.weights(CLEAN), np.minimum(1, np.square(CLEAN / own)), rtol=1e-5)


def test_where_nothing_is_seen_no_slope_is_less_known_than_the_steepest():
    found = prepared()(slopes_of(0.2, unseen=patch(), residual=np.full(SHAPE, 1e9, np.float32)))
    assert found.read[patch()].min() > 40
    assert found.solved.max() == STEEPEST_GEL
    assert not found.steep[patch()].any()


def wall(height=0.8):
    slopes = np.zeros((*SHAPE, 2), np.float32)
    slopes[:, 30:32, 0] = height
    return slopes


def test_a_wall_two_pixels_wide_is_doubted_beside_its_edges_alone():
    found = prepared()(slopes_of(wall()), rows=True).rows["wall"]
    one, both = (ERROR_OF_DIFFERENCE * (size - DIFFERENCE_FROM) for size in (0.8 / np.sqrt(2), 0.8))
    np.testing.assert_allclose(found[5, 27:35], [0, one, one, both, both, one, one, 0], rtol=1e-5)
    assert not found[:, [*range(28), *range(34, SHAPE[1])]].any()
    assert not prepared(walls=False)(slopes_of(wall()), rows=True).rows["wall"].any(), "the blur is unknown"


@pytest.mark.parametrize("radius_px", [40.0, 60.0])
def test_a_ball_is_no_wall_up_to_its_rim(radius_px):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    found = prepared()(slopes_of(ball_gradients(x, y, (36.0, 20.0), radius_px)), rows=True)
    assert not found.rows["wall"][np.hypot(x - 36, y - 20) < 0.4 * radius_px].any()


def test_noise_becomes_slope_by_gain_and_worth():
    background = GRAY.copy()
    background[:, 36:] = 50
    made = prepared(background=background, slope_per_change=1.5)
    gain = gain_from_background(background, CHANGE).mean(axis=-1)
    found = made(slopes_of(), 4.0, rows=True).rows["compression"]
    np.testing.assert_allclose(found, 6 * gain, rtol=1e-5)


def steep_at(slopes, **unit):
    return prepared(replace(LAW, per_slope=0.0), walls=False, **unit)(
        slopes_of(np.resize(np.float32(slopes), SHAPE[1]))
    ).steep[0, : len(slopes)]


def test_a_unit_s_own_slopes_are_known_as_far_as_presses_showed_them():
    """An error of a slope's size is stated of both components."""
    found = steep_at([0.0, 0.3, 0.5, 0.6, 0.7])
    np.testing.assert_allclose(found, PER_EXCESS * np.array([0, 0, 0, 0.1, 0.2]), atol=1e-6)
    assert steep_at([50.0])[0] == pytest.approx(STEEPEST_GEL)


def test_two_sigma_of_another_unit_s_slopes_reach_the_steepest_face():
    slopes = np.array([0.3, 0.35, 0.45])
    found = steep_at(slopes, carried=1.0)
    np.testing.assert_allclose(slopes + 2 * found, STEEPEST_FACE, rtol=1e-5)
    np.testing.assert_allclose(steep_at([0.0, 0.1, 0.3 - CLEAN], carried=1.0), 0, atol=1e-6)
    np.testing.assert_allclose(steep_at(slopes, carried=0.25), found / 4, rtol=1e-5)


def test_the_bias_is_subtracted_and_hidden_pixels_are_left_out():
    gradients = np.full((3, 4, 2), 0.25, dtype=np.float32)
    hidden = np.zeros((3, 4), dtype=bool)
    hidden[1, 2] = True
    gradients[hidden] = 1
    at_rest, findings = without_bias(np.zeros((3, 4, 3), np.float32), gradients, 0.1, hidden)
    np.testing.assert_array_equal(gradients[~hidden], 0)
    np.testing.assert_array_equal(gradients[hidden], 0.75)
    np.testing.assert_array_equal(at_rest, ~hidden)
    assert findings == ()


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e16])
@pytest.mark.parametrize("component", [0, 1])
def test_slopes_that_no_sum_can_hold_are_refused(wrong, component):
    gradients = np.zeros((5, 31, 2), np.float32)
    gradients[4, 30, component] = wrong
    with pytest.raises(ValueError, match="Expected slopes up to 1e"):
        without_bias(np.zeros((5, 31, 3), np.float32), gradients, 0.1)


UNTOUCHED = (40, 60)


def untouched_in(change, threshold, hidden=None):
    """`without_bias` where no slope is."""
    return without_bias(change, np.zeros((*UNTOUCHED, 2), np.float32), threshold, hidden)


def test_pixels_at_rest_have_the_change_of_most():
    change = np.random.default_rng(0).normal(0.05, 0.01, (*UNTOUCHED, 3)).astype(np.float32)
    change[:10] += np.array([0.2, -0.2, 0.1], dtype=np.float32)
    at_rest, findings = untouched_in(change, 0.08)
    np.testing.assert_array_equal(at_rest, np.broadcast_to(np.arange(40)[:, None] >= 10, UNTOUCHED))
    assert findings == ()


def test_where_everything_is_touched_the_least_changed_stand_in():
    ramp = np.linspace(-0.5, 0.5, UNTOUCHED[1], dtype=np.float32)[None, :, None]
    change = np.broadcast_to(ramp, (*UNTOUCHED, 3)) + np.float32(0.6)
    at_rest, (finding,) = untouched_in(change, 1e-6)
    assert finding.name == "few_untouched"
    assert finding.figure < MIN_UNTOUCHED
    assert finding.message.startswith(f"Only {100 * finding.figure:.1f} % of the pixels are at rest.")
    assert at_rest.mean() == pytest.approx(MIN_UNTOUCHED, abs=1 / UNTOUCHED[1])
    assert at_rest[:, 0].all()  # 0.1 is the least change
    gradients = np.random.default_rng(1).normal(0, 1, (*UNTOUCHED, 2)).astype(np.float32)
    without = gradients.copy()
    without_bias(change, without, 1e-6)
    bias = np.broadcast_to(np.median(gradients[at_rest], axis=0), gradients.shape)
    np.testing.assert_allclose(gradients - without, bias, atol=1e-6)


def test_hidden_pixels_have_no_say():
    """Everything but a corner is touched, and markers hide the corner."""
    change = np.random.default_rng(2).uniform(-1, 1, (*UNTOUCHED, 3)).astype(np.float32)
    change[30:, 40:] = 0
    hidden = np.zeros(UNTOUCHED, dtype=bool)
    assert untouched_in(change, 0.2, hidden)[1] == ()
    hidden[30:, 40:] = True
    assert untouched_in(change, 0.2, hidden)[1] != ()


@pytest.mark.parametrize("shape", [(40, 60), (41, 61), (480, 640)])
def test_the_bias_is_the_median_slope_of_the_untouched(shape):
    gradients = np.random.default_rng(1).normal(0, 0.02, (*shape, 2)).astype(np.float32)
    gradients += np.array([0.05, -0.03], dtype=np.float32)
    change = np.zeros((*shape, 3), dtype=np.float32)
    touched_rows = shape[0] // 3
    change[:touched_rows], gradients[:touched_rows] = 0.5, 2.0
    without = gradients.copy()
    without_bias(change, without, 0.1)
    bias = (gradients - without)[-1, -1]
    np.testing.assert_allclose(bias, np.median(gradients[touched_rows:], axis=(0, 1)), atol=2e-3)
    if shape[0] * shape[1] < 5000:  # no lattice is needed
        np.testing.assert_allclose(bias, np.median(gradients[touched_rows:], axis=(0, 1)), rtol=1e-6)


def numpy_at_rest(
    change, hidden, given, gradients, at_rest, refused, work, square, highest, share, coarse, step
):
    if given is None:
        near = np.square(change - np.median(change[::coarse, ::coarse], axis=(0, 1))).sum(axis=-1) < square
        near &= True if hidden is None else ~hidden
        if near[::step, ::step].mean() < share:
            at_rest[::step, ::step] = near[::step, ::step]
            return gradients, at_rest, np.zeros(1)
    else:
        near = given
    chosen = gradients[::step, ::step][near[::step, ::step]]
    without = gradients - (np.median(chosen, axis=0) if len(chosen) else 0)
    return without, near, np.array([np.any(np.abs(without) > highest, axis=-1).sum()])


def numpy_weights(residual, of_model, unseen, weight, outlier, unknown, full, least):
    residual = np.zeros(weight.shape) if residual is None else residual.astype(float)
    off = unknown * np.maximum(2 * residual / outlier - 1, 0)
    square = off**2 + (0 if of_model is None else np.maximum(of_model.astype(float) ** 2 - full**2, 0))
    found = np.maximum(full**2 / (full**2 + square), least)
    return (found if unseen is None else np.where(unseen, least, found),)


def numpy_budget(
    gradients, at_rest, rest, of_step, of_model, residual, unseen, gain, light, read, solved, steep, whole, confidence,
    rows, numbers,
):  # fmt: skip
    """What the kernel should give, in float64."""
    (
        per_step, per_size, factor, unknown, outlier, unseen_sigma, full, noise, per_bend, bend_from, spread, shown,
        per_excess, doubted, steepest, carried, ball_x, ball_y, ball_radius, of_ball, reach,
    ) = numbers.astype(float)  # fmt: skip
    g, (height, width), reach = gradients.astype(float), at_rest.shape, int(reach)
    square, size = np.zeros(at_rest.shape), np.linalg.norm(g, axis=-1)
    for a, b in np.ndindex(height, width):
        for y, x in ((a - reach, b), (a + reach, b), (a, b - reach), (a, b + reach)):
            if 0 <= y < height and 0 <= x < width:
                square[a, b] += ((g[y, x] - g[a, b]) ** 2).sum() / 2
    bend = (per_bend * np.maximum(np.sqrt(square) - bend_from, 0)) ** 2 if per_bend > 0 else 0 * square
    off = np.zeros(at_rest.shape)
    nothing = np.zeros(at_rest.shape, bool) if unseen is None else unseen
    if residual is not None:
        off = (unknown * np.maximum(2 * residual.astype(float) / outlier - 1, 0)) ** 2
    law = np.where(at_rest, rest, (per_step + per_size * size**2) * (1 if of_step is None else of_step))
    if of_model is not None:
        off += np.maximum(of_model.astype(float) ** 2 - law, 0)
    off = np.where(nothing, 0, np.minimum(off, unseen_sigma**2))
    total = law + bend + off + (noise * gain) ** 2 + nothing * unseen_sigma**2
    total = total if light is None else total + light.astype(float) ** 2
    own = per_excess * np.maximum(size - shown, 0)
    y, x = np.indices(size.shape)
    doubted = np.where(np.hypot(x - ball_x, y - ball_y) < ball_radius, of_ball, doubted)
    other = carried * np.clip((size - doubted) / full + 1, 0, 1) * np.maximum(steepest - size, 0)
    missing = np.where(total < unknown**2, np.minimum(own**2 + other**2, unknown**2), 0)
    unit = spread**2 * size**2
    of_solved = np.minimum(factor**2 * total, unknown**2) + unit
    maps = [
        np.sqrt(total), np.sqrt(of_solved), np.sqrt(missing), np.sqrt(of_solved + missing),
        np.minimum(full**2 / (total + unit + missing), 1),
    ]  # fmt: skip
    of_light = 0 * law if light is None else light.astype(float)
    parts = law, (noise * gain) ** 2, bend, off, of_light**2, nothing * unseen_sigma**2, unit, missing
    return (*maps, np.sqrt(parts))


def test_the_kernel_tells_what_it_takes_and_adds():
    """So a number or a row that it does not have in common with its caller cannot be passed."""
    numbers, rows = names_in_budget()
    assert set(numbers) == {*prepared()._numbers, "outlier", "noise"}
    assert rows == ("law", "compression", "wall", "outlier", "light", "unseen", "unit", "steep")
    wrong = [np.zeros(len(numbers) + 1, np.float32), np.zeros(0, np.float32)]
    maps = [np.zeros((3, 4), np.float32) for _ in range(5)]
    for one in wrong:
        with pytest.raises(ValueError, match="do not fit"):
            budget._slope_budget(
                np.zeros((3, 4, 2), np.float32), np.zeros((3, 4), bool), maps[0], None, None, None, None, maps[0], None,
                *maps, None, one,
            )  # fmt: skip


def test_the_kernels_agree_with_numpy():
    assert_kernel_agrees(budget._slope_budget, numpy_budget)
    text = " ".join(sum(names_in_budget(), ()))
    assert_kernel_agrees(
        budget._slope_budget_names,
        lambda one: np.frombuffer(f" {text}".encode(), np.uint8),
        np.zeros(len(text) + 1, np.uint8),
    )
    assert_kernel_agrees(budget._slope_weights, numpy_weights)
    assert_kernel_agrees(budget._slopes_at_rest, numpy_at_rest)


def linear(matrix):
    """Slopes from a color change by a fixed matrix (3, 2)."""
    matrix = np.array(matrix, np.float32)
    return SimpleNamespace(gradients_from_color=lambda change: (change @ matrix, None))


MODEL = linear([[1, 0], [0.3, 2], [0, 0.5]])


def untouched(background):
    return PreparedBackground(background.astype(np.float32), ChangeSettings(method="divide", offset=10.0))


def test_noise_at_rest_is_that_of_many_noisy_images():
    x = np.linspace(60, 200, 96)
    background = np.stack([np.tile(x, (64, 1)), np.tile(x[::-1], (64, 1)), np.full((64, 96), 90.0)], axis=-1)
    levels, rng, image = (1.0, 3.0, 2.0), np.random.default_rng(0), untouched(background)
    slopes = [
        MODEL.gradients_from_color(image.change(background + rng.normal(0, levels, background.shape)))[0]
        for _ in range(60)
    ]
    found = noise_at_rest(MODEL, image, levels)
    inner = slice(16, -16)  # the map is smooth over 8 px
    np.testing.assert_allclose(found[32, inner], np.mean(np.square(slopes), axis=(0, 1, 3))[inner], rtol=0.2)
    assert found.dtype == np.float32
    alike = noise_at_rest(MODEL, image, (USUAL_LEVELS,) * 3)
    np.testing.assert_array_equal(noise_at_rest(MODEL, image, None), alike)


def starter_of(calibration):
    """The same calibration as one of other units."""
    made = {"sensor": "x", "spread": 0.0, "units": ["others"], "findings": []}
    return replace(calibration, settings=replace(calibration.settings, starter=made))


def test_doubt_of_steep_slopes_changes_what_is_stated_and_no_depth(calibration, sensor):
    image = simulate_press(sensor, BoxEdge(8.0), depth_mm=0.5, rng=np.random.default_rng(1)).image
    doubts = gelform.Reconstructor(starter_of(calibration))
    doubted, plain = doubts.from_image(image), gelform.Reconstructor(calibration).from_image(image)
    for name in ("depth", "gradients", "observed_gradients", "contact", "known"):
        np.testing.assert_array_equal(getattr(doubted, name), getattr(plain, name), err_msg=name)
    slopes = np.linalg.norm(plain.observed_gradients, axis=-1)
    steeper = (slopes > calibration.slope_sigma.shown[0] + 0.05) & (plain.confidence > 0.9)
    assert steeper.sum() > 100
    assert doubted.confidence[steeper].max() < 0.3
    assert (doubted.gradients_sigma > plain.gradients_sigma)[steeper].all()
    top = plain.depth_mm.argmax()
    assert doubted.depth_sigma_mm.flat[top] > 2 * plain.depth_sigma_mm.flat[top]
    assert "steep" in {one.name for one in doubted.health}
    assert "steep" not in {one.name for one in plain.health}
    assert "steep" in {one.name for one in doubts.explain(image).findings}


def test_the_slopes_of_a_ball_are_not_doubted_though_its_model_is_of_other_units(calibration, sensor):
    """It shows all slopes up to its steepest without a break, so nothing of its height is missing."""
    image = simulate_press(sensor, Ball(3.0), depth_mm=0.8, rng=np.random.default_rng(1)).image
    other, own = (gelform.Reconstructor(of) for of in (starter_of(calibration), calibration))
    carried, plain = other.from_image(image), own.from_image(image)
    for findings in (
        carried.health,
        plain.health,
        other.explain(image).findings,
        own.explain(image).findings,
    ):
        assert "steep" not in {one.name for one in findings}
    top = plain.depth_mm.argmax()
    assert carried.depth_sigma_mm.flat[top] < 1.5 * plain.depth_sigma_mm.flat[top]


def test_a_ball_vouches_for_nothing_beside_it(calibration, sensor):
    """The deepest of two objects is a ball; the slopes of a box beside its gel are as doubtful as without it."""
    ball = Placed(Ball(3.0), center_mm=(4.5, 0.0))
    box = Placed(BoxEdge(4.0), center_mm=(-5.0, 0.0), back_mm=0.1)
    faces = (Several((replace(box, back_mm=0.0),)), 0.6), (Several((ball, box)), 0.7)
    presses = (simulate_press(sensor, f, depth_mm=d, rng=np.random.default_rng(1)) for f, d in faces)
    reconstruct = gelform.Reconstructor(starter_of(calibration))
    alone, both = (reconstruct.from_image(press.image) for press in presses)
    left = np.s_[:, :60]
    steep = np.linalg.norm(alone.gradients[left], axis=-1) > 0.3
    assert steep.sum() > 100
    assert np.median(both.gradients_sigma[left][steep]) > 0.9 * np.median(alone.gradients_sigma[left][steep])


@pytest.mark.slow
def test_the_faces_of_a_cube_are_never_sure_by_a_starter(data):
    """They stand at some 45 degrees and are read at half of that; the edge is as much too low."""
    background, images = edges_of_cube.frames()
    calibration = load_starter("gelsight-mini").for_unit(background)
    reconstruct, pitch = gelform.Reconstructor(calibration), calibration.known_mm_per_px
    rows = []
    for name in ("0.png", "24.png", "50.png"):
        result = reconstruct.from_image(images[name])
        edge = edges_of_cube.edge_in(result.gradients, pitch)
        error = edges_of_cube.crest_error_mm(edge, result.depth_mm, pitch)
        assert error > 0.2
        assert error < 2.5 * result.depth_sigma_mm[edge.crest].mean()
        assert "steep" in {one.name for one in result.health}
        for face, true in zip(edge.faces, edge.true_gradients):
            off = np.abs((result.gradients[face] - true) @ edge.across)
            assert np.median(off) > 0.2
            sigma = np.hypot(*(result.gradients_sigma[face] * edge.across).T)
            rows.append([(off < 2 * sigma).mean(), (result.confidence[face] > 0.3).mean()])
    within, sure = np.mean(rows, axis=0)
    assert within > 0.85
    assert sure < 0.15


SHAPE_BALL, RADIUS_PX, GENTLE = (120, 160), 50.0, 0.35


def ball_at(center, contact_px=35.0):
    """Slopes (H, W, 2) of a ball, which fall off where the gel leaves it; and its top."""
    y, x = np.mgrid[: SHAPE_BALL[0], : SHAPE_BALL[1]].astype(float)
    away = np.hypot(x - center[0], y - center[1])
    edge = np.minimum(1, contact_px / np.maximum(away, 1e-9))
    at_edge = center[0] + (x - center[0]) * edge, center[1] + (y - center[1]) * edge
    inside = ball_gradients(*at_edge, center, RADIUS_PX)
    fall = np.exp(-np.maximum(away - contact_px, 0) / 5)
    return (inside * fall[..., None]).astype(np.float32), (round(center[1]), round(center[0]))


@pytest.mark.parametrize("center", [(80, 60), (70.4, 51.7), (30, 112)])
def test_a_ball_is_followed_to_where_the_gel_leaves_it(center):
    """At (30, 112) the border cuts it."""
    slopes, top = ball_at(center)
    steepest = float(np.hypot(*ball_gradients(center[0] + 35.0, center[1], center, RADIUS_PX)))
    for place in (top, (top[0] + 2, top[1] - 2)):  # noise moves the top
        found = slopes_of_ball(slopes, place, GENTLE)
        assert found.of_ball == pytest.approx(steepest, rel=0.12)
        assert found[:2] == pytest.approx(center, abs=1.5)
        assert found.ball_radius == pytest.approx(GEL_RADII * 35.0, rel=0.1)


def test_readings_that_bend_are_followed_until_they_miss_a_seventh():
    slopes, top = ball_at((80, 60), contact_px=45.0)
    size = np.linalg.norm(slopes, axis=-1, keepdims=True)
    bent = slopes * np.where(size > 0.4, (0.4 + 0.2 * (size - 0.4)) / np.maximum(size, 1e-9), 1)
    found = slopes_of_ball(bent.astype(np.float32), top, GENTLE).of_ball
    sine = found / np.sqrt(1 + found**2)
    read = 0.4 + 0.2 * (found - 0.4)
    assert read / np.sqrt(1 + read**2) == pytest.approx(FOLLOWED * sine, rel=0.05)


def test_a_roof_a_cone_a_cylinder_and_gentle_gel_show_no_ball():
    y, x = np.mgrid[: SHAPE_BALL[0], : SHAPE_BALL[1]].astype(float)
    u, v = x - 80, y - 60
    away = np.maximum(np.hypot(u, v), 1)
    round_ = ball_gradients(x, 60 + 0 * y, (80, 60), RADIUS_PX)
    cone = -0.5 * np.stack([u, v], axis=-1) / away[..., None] * np.minimum(1, away / 3)[..., None]
    roof = np.stack([-0.45 * np.tanh(u / 4), 0 * v], axis=-1)
    for face in (roof, cone, round_, 0 * roof):
        assert slopes_of_ball(face.astype(np.float32), (60, 80), GENTLE) is None
