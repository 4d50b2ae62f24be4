"""The page's binary messages: a header and planes of pixels."""

from gelform.live.wire.message import message, read_message
from gelform.live.wire.planes import ENCODINGS, Plane, depth_plane, image_plane, level_plane

__all__ = ["ENCODINGS", "Plane", "depth_plane", "image_plane", "level_plane", "message", "read_message"]
