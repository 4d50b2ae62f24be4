"""Where a fit may begin: models of other units and of other kinds, and the starters of makes."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.calibration import start as module
from gelform.calibration.start import start_from, starter_start, translated
from gelform.calibration.starters import load_starter
from gelform.errors import CalibrationError
from gelform.image.background import gain_from_background
from gelform.simulate import Ball, simulate_press
from gelform.slopes.color_models import HierarchicalModel


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
    gel = lambertian_calibration.settings
    assert (start.edge, start.relaxation_mm) == (gel.contact_radius_ratio, gel.relaxation_mm)
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


def test_what_cannot_be_started_from_is_said(lambertian_calibration, calibration, presses):
    other_shape = replace(calibration, color_model=replace(calibration.color_model, shape=(10, 10)))
    for first, model, error, said in (
        (calibration, "lambertian", ValueError, "--model hierarchical"),
        (other_shape, "auto", ValueError, "10x10 px"),
        (
            replace(lambertian_calibration, image_shape=(10, 20)),
            "auto",
            ValueError,
            "132x176 px, got one for 10x20",
        ),
        (replace(lambertian_calibration, forward=None), "auto", CalibrationError, "what color a slope gives"),
    ):
        with pytest.raises(error, match=said):
            start_from(first, presses, model)


def test_the_make_brings_the_starter_whatever_the_sensor_is_called(presses, monkeypatch):
    light = load_starter("gelsight-mini").calibration.background
    mine = replace(presses, background=light, mm_per_px=0.0634, sensor_name="my Mini")
    mini, nothing = replace(mine, make="gelsight-mini"), (None, ())
    assert starter_start(mine, "auto") == nothing
    assert starter_start(replace(mine, make="simulated-three-edges"), "auto") == nothing, (
        "no make that one has"
    )
    start, note = starter_start(mini, "auto")
    assert ("GelSight Mini" in start.by, start.offered, note) == (True, True, ())
    start, (note,) = starter_start(mini, "lookup")
    assert not start.offered
    assert "it is of the color model hierarchical, and lookup was asked for." in note
    small, strange = replace(mine, make="digit"), replace(mini, background=mini.background[..., ::-1].copy())
    for other, said in (
        (small, "a DIGIT was not tried, because it is for images of 320x240 px, and these are 240x320 px."),
        (strange, "a GelSight Mini was not tried, because The background is BGR"),
    ):
        start, (note,) = starter_start(other, "auto")
        assert start is None
        assert note.startswith(f"The starter of {said}")
    starter = load_starter("gelsight-mini")
    own = replace(starter.calibration, training_digests=("of others", mini.presses[1].digest))
    monkeypatch.setattr(module, "starter_of_make", lambda _: replace(starter, calibration=own))
    start, (note,) = starter_start(mini, "auto")
    assert (start.offered, start.own, "it was made from these presses." in note) == (False, True, True)
