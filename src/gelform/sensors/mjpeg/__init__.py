"""Motion JPEG: a picture decoded at the size that is needed, and streams of them from an address."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "jpeg": ["image_from_jpeg", "jpeg_shape", "reduction_of"],
        "parts": ["PartSplitter"],
        "http_body": ["HttpBody"],
        "url": ["MjpegUrl"],
    },
)
