"""The seam, asked of every model in COLOR_MODELS: no change no slope, frames equal pixels, saved arrays, variants."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from gelform.slopes.color_models import COLOR_MODELS, IMPORTED_MODELS
from gelform.slopes.color_models.seam import Stored, check_image_shape
from made.color_samples import SHAPE, ball_samples, shading_change


def fitted(name, samples, **settings):
    """A fitted model; where it takes torch to train, a test of it is skipped without."""
    if name == "mlp":
        pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
        settings = {"steps": 200, **settings}
    return COLOR_MODELS[name].fit(samples, **settings)


@cache
def model_of(name):
    """Fitted to lights that turn over the image; once for all tests."""
    return fitted(name, ball_samples(shading_change))


@pytest.mark.parametrize("name", COLOR_MODELS)
def test_no_color_change_means_no_slope(name):
    model = model_of(name)
    prepared = model.prepare(np.full((*SHAPE, 3), 100, np.float32), SHAPE)
    gradients, _ = prepared.gradients_from_color(np.zeros((*SHAPE, 3), dtype=np.float32))
    np.testing.assert_allclose(gradients, 0, atol=1e-6)


@pytest.mark.parametrize("name", COLOR_MODELS)
def test_a_frame_equals_its_pixels_one_by_one(name):
    model = model_of(name)
    change = np.random.default_rng(1).uniform(-0.3, 0.3, (*SHAPE, 3)).astype(np.float32)
    frame, _ = model.prepare(np.full((*SHAPE, 3), 100, np.float32), SHAPE).gradients_from_color(change)
    y, x = (axis.ravel() for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])
    pixels = model.gradients_at(change.reshape(-1, 3), x, y)
    np.testing.assert_allclose(frame.reshape(-1, 2), pixels, atol=2e-5)


@pytest.mark.parametrize("name", COLOR_MODELS)
def test_saved_arrays_give_the_same_model(name):
    model = model_of(name)
    again = COLOR_MODELS[name].from_arrays(*model.to_arrays())
    samples = ball_samples(shading_change, seed=2)
    for a, b in zip(
        *(m.gradients_at(samples.color_change, samples.x_px, samples.y_px) for m in (model, again))
    ):
        np.testing.assert_array_equal(a, b)


@dataclass(frozen=True, eq=False)
class Record(Stored):
    nodes: NDArray[np.float64]
    shape: tuple[int, int]
    mask: NDArray[np.bool_] | None = None
    sigma: tuple[float, float] | None = None
    gain: Literal["none", "some"] = "none"

    name: ClassVar[str] = "record"


@pytest.mark.parametrize("more", [{}, {"mask": np.eye(2, dtype=bool), "sigma": (0.5, 2.0), "gain": "some"}])
def test_a_record_comes_back_from_a_file_with_its_types(more):
    record = Record(np.arange(3.0), (24, 32), **more)
    arrays, settings = record.to_arrays()
    assert arrays.keys() == {"nodes", *(["mask"] if more else [])}
    assert settings == {"shape": [24, 32], "sigma": (more and [0.5, 2.0]) or None, "gain": record.gain}
    again = Record.from_arrays(arrays, json.loads(json.dumps(settings)))
    assert (again.shape, again.sigma, again.gain) == (record.shape, record.sigma, record.gain)
    np.testing.assert_array_equal(again.nodes, record.nodes)
    np.testing.assert_array_equal(again.mask, record.mask)


def test_a_file_may_lack_what_has_a_default_and_nothing_else():
    assert Record.from_arrays({"nodes": np.zeros(2)}, {"shape": [1, 2]}).gain == "none"
    with pytest.raises(KeyError, match="nodes"):
        Record.from_arrays({}, {"shape": [1, 2]})
    with pytest.raises(KeyError, match="shape"):
        Record.from_arrays({"nodes": np.zeros(2)}, {"gain": "some"})


@pytest.mark.parametrize("shape", [[24], [24, 32, 3], 24, "ab", None])
def test_a_tuple_of_another_length_or_kind_is_refused(shape):
    with pytest.raises(TypeError, match="shape"):
        Record.from_arrays({"nodes": np.zeros(2)}, {"shape": shape})


@pytest.mark.parametrize("name", COLOR_MODELS)
def test_variants_are_settings_of_its_fit(name):
    samples = ball_samples(shading_change)
    for presses in (2, 10, 20, 100):
        variants = COLOR_MODELS[name].variants(presses)
        assert variants
        assert all(variants.count(one) == 1 for one in variants)
    for variant in variants:
        fitted(name, samples, **variant)


def test_models_are_listed_under_their_own_names():
    for table in (COLOR_MODELS, IMPORTED_MODELS):
        assert all(model.name == name for name, model in table.items())
    assert not COLOR_MODELS.keys() & IMPORTED_MODELS.keys()


@pytest.mark.parametrize(
    "name", [name for name in COLOR_MODELS if name != "lambertian"]
)  # one law everywhere
def test_images_of_another_size_are_refused(name):
    with pytest.raises(ValueError, match="as calibrated, got 10x10"):
        model_of(name).prepare(np.zeros((10, 10, 3)), (10, 10))
    check_image_shape((48, 64), (48, 64))
    with pytest.raises(ValueError, match="Expected images of 48x64 px, as imported, got 64x48"):
        check_image_shape((64, 48), (48, 64), made="imported")
