"""frame -> image and back: the view, its lens, and resampling in one pass."""

from gelform.image.view.lens import Lens
from gelform.image.view.view import (
    FLIPS,
    View,
    frame_from_image,
    frame_px_from_image_px,
    image_from_frame,
    image_px_from_frame_px,
)

__all__ = [
    "FLIPS",
    "Lens",
    "View",
    "frame_from_image",
    "frame_px_from_image_px",
    "image_from_frame",
    "image_px_from_frame_px",
]
