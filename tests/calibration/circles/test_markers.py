"""A gel with markers calibrates nearly as well as the same gel without: the dots' pixels are left out."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.background.change import ChangeSettings, PreparedBackground, color_change_from_image
from gelform.calibration.circles.markers import change_without_markers
from gelform.calibration.circles.prepare import prepare
from gelform.design.study import _as_read
from gelform.markers import MarkerFinder
from gelform.simulate import Ball, Pose, simulate_background, simulate_ball_presses, simulate_sequence


def presses_of(sensor, pitch_mm):
    coating = replace(sensor.coating, marker_pitch_mm=pitch_mm, marker_radius_mm=0.25)
    made = simulate_ball_presses(
        replace(sensor, coating=coating, gel=replace(sensor.gel, bulge=0.5)),  # a bulge moves the dots
        ball_diameters_mm=[5.0],
        count=20,
        rng=np.random.default_rng(3),
        oversample=1,
    )
    return made, _as_read(made.presses, made.background, made.sensor)


@pytest.fixture(scope="module")
def plain(sensor):
    return presses_of(sensor, 0.0)


@pytest.fixture(scope="module")
def dotted(sensor):
    return presses_of(sensor, 2.2)


def test_the_change_is_that_of_the_unmarked_gel(plain, dotted):
    settings = ChangeSettings("divide", 10, 0.7)
    background = dotted[1].background
    finder = MarkerFinder(background)
    spoilt, errors, left_out = [], [], []
    for clean, press in zip(plain[0].presses, dotted[0].presses):
        change, usable = change_without_markers(
            press.image, PreparedBackground(background, settings), None, finder
        )
        wanted = color_change_from_image(clean.image, plain[1].background, settings)
        raw = color_change_from_image(press.image, background, settings)
        spoilt.append(np.abs(raw - wanted).mean(axis=-1))
        errors.append(np.abs(change - wanted).mean(axis=-1))
        left_out.append(~usable)
    spoilt, errors, left_out = (np.stack(maps) for maps in (spoilt, errors, left_out))
    assert np.count_nonzero(spoilt > 0.2) > 40  # dots that moved
    assert left_out[spoilt > 0.2].mean() > 0.95
    assert left_out.mean() < 0.4
    assert np.mean(errors[spoilt > 0.2]) < 0.5 * np.mean(spoilt[spoilt > 0.2])


def test_dots_that_were_dragged_are_left_out_where_they_are_and_where_they_were(sensor):
    images = []
    for pitch_mm in (0.0, 2.2):
        coating = replace(sensor.coating, marker_pitch_mm=pitch_mm, marker_radius_mm=0.25)
        gel = replace(sensor, coating=coating, noise_sd=0, noise_gain=0)
        poses = [Pose(0.8, (-3 + 0.25 * k, 0.0)) for k in range(8)]
        *_, last = simulate_sequence(gel, Ball(4), poses, rng=None)
        images.append((simulate_background(gel, None).astype(np.float32), last))
    (clean_rest, clean), (rest, press) = images
    assert np.abs(press.markers_shift_mm).max() > 0.3  # more than a dot's radius
    settings = ChangeSettings("divide", 10, 0.7)
    finder = MarkerFinder(rest)
    _, usable = change_without_markers(press.image, PreparedBackground(rest, settings), None, finder)
    raw = color_change_from_image(press.image, rest, settings)
    spoilt = np.abs(raw - color_change_from_image(clean.image, clean_rest, settings)).mean(axis=-1)
    assert np.count_nonzero(spoilt > 0.2) > 50
    assert np.mean(usable[spoilt > 0.2]) < 0.05
    assert np.mean(usable) > 0.6
    assert np.mean(finder.mask(press.image, 2)[spoilt > 0.2]) > 0.95  # the fast way sees them too


def test_an_unmarked_gel_is_left_as_it_is(plain):
    made, presses = plain
    settings = ChangeSettings("divide", 10, 0.7)
    image = made.presses[0].image
    change, usable = change_without_markers(
        image, PreparedBackground(presses.background, settings), None, MarkerFinder(presses.background)
    )
    assert usable is None
    np.testing.assert_array_equal(change, color_change_from_image(image, presses.background, settings))


def test_samples_leave_the_dots_out(dotted):
    made, presses = dotted
    for true, press in zip(made.presses, prepare(presses, 10.0)):
        from gelform.calibration.circles.find import ContactCircle

        contact = ContactCircle(*true.center_px, true.contact_radius_px, 1.0, 9.0)
        rows, cols = press.pixels(contact, 0.8)
        assert len(rows) > 30
        assert true.albedo[rows, cols].min() > 0.9
        assert (true.albedo < 0.5).any()


def slope_error(calibration, made, presses):
    """Median slope error in the contacts against the exact truth, on the pixels without dots."""
    errors = []
    for true, press in zip(made.presses, prepare(presses, calibration.change.offset)):
        usable = np.ones(true.contact.shape, bool) if press.usable is None else press.usable
        inside = np.argwhere(true.contact & usable)
        found = press.gradients(calibration.color_model, inside[:, 0], inside[:, 1])
        errors.append(np.linalg.norm(found - true.gradients[inside[:, 0], inside[:, 1]], axis=1))
    return float(np.median(np.concatenate(errors)))


def test_calibration_of_a_marked_gel(plain, dotted):
    errors, used = [], []
    for made, presses in (plain, dotted):
        training = presses.subset(range(0, 20, 2)), replace(made, presses=made.presses[::2])
        calibration = gelform.calibrate(training[0], color_model="polynomial")
        held_out = replace(made, presses=made.presses[1::2]), presses.subset(range(1, 20, 2))
        errors.append(slope_error(calibration, *held_out))
        used.append(sum(row.accepted for row in calibration.report.presses))
        for row, true in zip(calibration.report.presses, made.presses[::2]):
            if row.accepted:
                off = np.hypot(row.center_x_px - true.center_px[0], row.center_y_px - true.center_px[1])
                assert off < 4
    assert used[1] >= used[0] - 1
    assert errors[1] < 1.5 * errors[0]


def test_evaluation_finds_the_circles_of_a_marked_gel(dotted):
    made, presses = dotted
    few = presses.subset(range(0, 20, 3))
    evaluation = gelform.evaluate(gelform.calibrate(few, color_model="polynomial"), few)
    circles = np.array([row["circle_px"] for row in evaluation.rows])
    true = np.array([press.center_px for press in made.presses[::3]])
    assert np.median(np.linalg.norm(circles[:, :2] - true, axis=1)) < 1.5
