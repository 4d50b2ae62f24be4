"""gelform: depth in millimetres from the image of an RGB visual-tactile sensor.

The public names, in the order of the path:

    frame -> image -> color change -> gradients (by way of normals) -> depth
"""

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOME = {
    "Frame": "gelform.frames",
    "curl": "gelform.gradients",
    "gradients_from_normals": "gelform.gradients",
    "gradients_from_depth": "gelform.gradients",
    "fill": "gelform.gradients",
    "normals_from_image": "gelform.normals",
    "normals_from_gradients": "gelform.normals",
    "image_from_normals": "gelform.normals",
    "depth_from_gradients": "gelform.depth",
    "integrate": "gelform.depth",
    "Integration": "gelform.depth",
    "edge_residuals": "gelform.depth",
    "depth_sigma": "gelform.uncertainty",
    "warmup": "gelform.solvers.warmup",
    "GelformError": "gelform.errors",
    "CalibrationError": "gelform.errors",
    "SensorError": "gelform.errors",
    "ConvergenceError": "gelform.errors",
    "DataError": "gelform.errors",
}

if TYPE_CHECKING:
    from gelform.depth import Integration, depth_from_gradients, edge_residuals, integrate
    from gelform.errors import CalibrationError, ConvergenceError, DataError, GelformError, SensorError
    from gelform.frames import Frame
    from gelform.gradients import curl, fill, gradients_from_depth, gradients_from_normals
    from gelform.normals import image_from_normals, normals_from_gradients, normals_from_image
    from gelform.solvers.warmup import warmup
    from gelform.uncertainty import depth_sigma

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for (PEP 562)."""
    if name in _HOME:
        return getattr(importlib.import_module(_HOME[name]), name)
    raise AttributeError(f"module 'gelform' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
