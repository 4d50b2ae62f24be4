"""gelform: depth in millimeters from the image of an RGB visual-tactile sensor.

    frame -> image -> color change -> gradients (by way of normals) -> depth

The public names are listed in `__init__.pyi`, in the order of this path; each is imported when first asked for.
"""

from importlib import import_module
from typing import Any
from warnings import warn

import lazy_loader

__version__ = "0.2.0.dev0"

_listed, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

MOVED = {  # public names up to 0.1 and their present modules; these aliases end with 0.3
    "Source": "sensors.source",
    "Lens": "view",
    "frame_from_image": "view",
    "ChangeSettings": "background.change",
    "read_background": "sensors.files",
    "exposure_from_image": "background.exposure",
    "Registration": "background.registration",
    "image_from_color_change": "background.change",
    "Markers": "markers.finder",
    "MarkerFlow": "markers.flow",
    "MarkerFollower": "markers.follower",
    "fill_unknown": "gradients",
    "edge_residuals": "depth",
    "contacts_from_mask": "contact",
    "with_crosstalk": "calibration.presses.folder",
    "with_view": "calibration.presses.folder",
    "save_picture": "plots.canvas",
    "press_errors": "metrics",
    "save_press_folder": "exporters.press_folder",
}


def __getattr__(name: str) -> Any:
    """Return a listed name; return a moved name with a warning."""
    if name not in MOVED:
        return _listed(name)
    module = f"gelform.{MOVED[name]}"
    warn(f"gelform.{name} ends with 0.3: use `from {module} import {name}`", DeprecationWarning, stacklevel=2)
    return getattr(import_module(module), name)
