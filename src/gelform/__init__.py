"""gelform: depth in millimeters from the image of an RGB visual-tactile sensor.

    frame -> image -> color change -> gradients (by way of normals) -> depth

The public names are listed in `__init__.pyi`, in the order of this path; each is imported when first asked for.
"""

import lazy_loader

__version__ = "0.1.0.dev0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
