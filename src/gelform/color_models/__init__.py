"""colour -> gradients: one model per file, listed in COLOR_MODELS.

A model is fitted on samples of ball presses, where the gradient is known, and prepared once for a background:

    model = COLOR_MODELS["polynomial"].fit(samples)
    gradients, gradients_sigma = model.prepare(background, shape).gradients_from_color(color_change)

No colour change means no slope, in every model.
"""

from typing import Any

from gelform.color_models._shared.slope_table import SlopeTableModel
from gelform.color_models.hierarchical import HierarchicalModel
from gelform.color_models.interpolation import InterpolationModel
from gelform.color_models.lambertian import LambertianModel
from gelform.color_models.lookup import LookupModel
from gelform.color_models.mlp import MlpModel
from gelform.color_models.near_light import NearLightModel
from gelform.color_models.network import NetworkModel
from gelform.color_models.polynomial import PolynomialModel
from gelform.color_models.seam import ColorModel, PreparedColorModel, Samples

COLOR_MODELS: dict[str, Any] = {
    "lambertian": LambertianModel,
    "near_light": NearLightModel,
    "polynomial": PolynomialModel,
    "hierarchical": HierarchicalModel,
    "interpolation": InterpolationModel,
    "mlp": MlpModel,
    "lookup": LookupModel,
}

# Made by other packages, never fitted here: only importers make them.
IMPORTED_MODELS: dict[str, Any] = {
    "network": NetworkModel,
    "slope_table": SlopeTableModel,
}

__all__ = [
    "COLOR_MODELS",
    "IMPORTED_MODELS",
    "ColorModel",
    "HierarchicalModel",
    "InterpolationModel",
    "LambertianModel",
    "LookupModel",
    "MlpModel",
    "NetworkModel",
    "NearLightModel",
    "PolynomialModel",
    "PreparedColorModel",
    "Samples",
    "SlopeTableModel",
]
