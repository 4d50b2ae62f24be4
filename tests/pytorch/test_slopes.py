"""Color models as modules read the gradients that the models themselves read."""

from types import SimpleNamespace

import numpy as np
import pytest

from gelform.errors import CalibrationError
from gelform.foundations.checks import HIGHEST_SLOPE
from gelform.slopes.color_models import HierarchicalModel, LambertianModel, NearLightModel

torch = pytest.importorskip("torch", reason="needs the extra 'torch'")
from gelform.torch.slopes import gradients_module  # noqa: E402

SHAPE = 12, 16
BACKGROUND = np.full((*SHAPE, 3), 90.0, np.float32)
LIGHTS = np.array([[0.5, 0.1, 1], [-0.3, 0.4, 1], [-0.2, -0.6, 1]])
POSITIONS_PX = np.array([[0.0, 20, 9], [18, -9, 8], [-17, -8, 10]])


@pytest.mark.parametrize(
    "model",
    [LambertianModel(LIGHTS, 0.8), NearLightModel(POSITIONS_PX, np.eye(3) + 0.1, 2.0, 1.0, SHAPE)],
    ids=lambda model: model.name,
)
def test_photometric_stereo_is_the_models_own(model):
    change = np.random.default_rng(0).uniform(-0.3, 0.5, (*SHAPE, 3)).astype(np.float32)
    y_px, x_px = (axis.ravel() for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])
    expected = model.gradients_at(change.reshape(-1, 3), x_px, y_px).reshape(*SHAPE, 2)
    found = gradients_module(model, BACKGROUND)(torch.from_numpy(change).permute(2, 0, 1)[None])[0]
    np.testing.assert_allclose(found.permute(1, 2, 0), expected, rtol=2e-4, atol=1e-5)


@pytest.mark.parametrize("steepest", [HIGHEST_SLOPE, 0.2])
def test_a_polynomial_is_the_models_own(steepest):
    model = HierarchicalModel(np.random.default_rng(3).normal(0, 0.3, (2, 2, 19, 2)), 3, SHAPE, steepest)
    change = np.random.default_rng(0).uniform(-0.3, 0.5, (*SHAPE, 3)).astype(np.float32)
    expected, over = model.prepare(BACKGROUND, SHAPE).gradients_from_color(change)
    assert (over is None) == (steepest == HIGHEST_SLOPE)
    found = gradients_module(model, BACKGROUND)(torch.from_numpy(change).permute(2, 0, 1)[None])[0]
    np.testing.assert_allclose(found.permute(1, 2, 0), expected, atol=1e-5)


def test_a_model_without_such_a_form_is_named():
    with pytest.raises(CalibrationError, match="--model hierarchical"):
        gradients_module(SimpleNamespace(name="network"), BACKGROUND)
