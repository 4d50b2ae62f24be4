"""Color models of pressed gel that is nearer to or farther from the lamps than untouched gel."""

from gelform.color_models.depth_aware.by_lights import DepthByLightsModel
from gelform.color_models.depth_aware.regressed import DepthAwareModel

__all__ = ["DepthAwareModel", "DepthByLightsModel"]
