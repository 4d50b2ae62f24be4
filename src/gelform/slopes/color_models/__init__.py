"""color -> gradients: the models, listed in COLOR_MODELS.

A model is fitted on samples of ball presses, where the gradient is known, and prepared once for a background:

    model = COLOR_MODELS["polynomial"].fit(samples)
    gradients, gradients_sigma = model.prepare(background, shape).gradients_from_color(color_change)

No color change means no slope, in every model.
"""

from gelform.slopes.color_models.forward_response import ForwardResponse
from gelform.slopes.color_models.networks import MlpModel, NetworkModel
from gelform.slopes.color_models.physical import LambertianModel, NearLightModel
from gelform.slopes.color_models.polynomial import HierarchicalModel, PolynomialModel
from gelform.slopes.color_models.seam import ColorModel, FittableColorModel, Samples, StartableModel
from gelform.slopes.color_models.tables import InterpolationModel, LookupModel

COLOR_MODELS: dict[str, type[FittableColorModel]] = {
    "lambertian": LambertianModel,
    "near_light": NearLightModel,
    "polynomial": PolynomialModel,
    "hierarchical": HierarchicalModel,
    "interpolation": InterpolationModel,
    "mlp": MlpModel,
    "lookup": LookupModel,
}

# Models that calibration uses by default: one that models the light at every place and can start at another unit's, and one
# of few terms, for few presses and for circles that are still uncertain.
DEFAULT_MODEL, PLAIN_MODEL = "hierarchical", "polynomial"

# Models that other packages made and `importers` reads; they are never fitted here.
IMPORTED_MODELS: dict[str, type[ColorModel]] = {"network": NetworkModel}

__all__ = ["COLOR_MODELS", "IMPORTED_MODELS", "ColorModel", "ForwardResponse", "Samples", "StartableModel"]
