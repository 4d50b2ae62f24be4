"""A second unit begins at any first unit's model: what `auto` chose, whatever it was, is one to start from."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.calibration.selection.candidates import Candidate
from gelform.calibration.start import start_from, translated
from gelform.color_models import HierarchicalModel
from gelform.errors import CalibrationError
from gelform.simulate import Ball, simulate_press


def test_a_translated_model_reads_the_slopes_that_the_first_one_reads(lambertian_calibration, simulated):
    """On the image of a ball that neither has seen: as far from the truth, and near to each other."""
    press = simulate_press(
        simulated.sensor, Ball(3.2), depth_mm=0.5, center_mm=(1.0, -1.0), rng=np.random.default_rng(2)
    )
    model = translated(lambertian_calibration)
    assert isinstance(model, HierarchicalModel)
    change = replace(lambertian_calibration.change, offset=HierarchicalModel.change_offset)
    other = replace(lambertian_calibration, color_model=model, change=change, gamut=None)
    y, x = np.mgrid[: press.image.shape[0], : press.image.shape[1]]
    inside = np.hypot(x - press.center_px[0], y - press.center_px[1]) < 0.8 * press.contact_radius_px
    first, second = (
        gelform.Reconstructor(one)(press.image).gradients[inside] for one in (lambertian_calibration, other)
    )
    assert np.sqrt(np.mean(first**2)) > 0.15
    assert np.sqrt(np.mean((first - second) ** 2)) < 0.04


def test_a_second_unit_starts_from_any_color_model(lambertian_calibration, presses):
    start = start_from(lambertian_calibration, presses, "auto")
    assert start.digest == lambertian_calibration.digest
    assert start.zone == lambertian_calibration.settings["zone"]
    assert start.model.degree == 3, "as the model that is drawn to it"


@pytest.mark.parametrize("kind", ["depth_aware", "depth_by_lights"])
def test_a_model_that_knows_the_depth_gives_its_plain_one(kind, prepared, found, presses, calibration):
    model = Candidate(kind, 0.8).fit(prepared, found, total=3000)
    start = start_from(replace(calibration, color_model=model), presses, "auto")
    assert start.model is model.plain


def test_a_start_without_a_forward_response_is_refused(lambertian_calibration, presses):
    with pytest.raises(CalibrationError, match="what colour a slope gives"):
        start_from(replace(lambertian_calibration, forward=None), presses, "auto")


def test_a_start_for_images_of_another_size_is_refused(lambertian_calibration, presses):
    with pytest.raises(ValueError, match="132x176 px, got one for 10x20 px"):
        start_from(replace(lambertian_calibration, image_shape=(10, 20)), presses, "auto")
