"""Depth of visual-tactile sensors as a camera of LeRobot: type "gelform"."""

from lerobot_camera_gelform.versions import check_versions

check_versions()

from lerobot_camera_gelform.config_gelform import GelformCameraConfig  # noqa: E402
from lerobot_camera_gelform.encoders import is_lossless, lossless_rgb_encoder, warn_if_lossy  # noqa: E402
from lerobot_camera_gelform.gelform_camera import GelformCamera  # noqa: E402

__all__ = ["GelformCamera", "GelformCameraConfig", "is_lossless", "lossless_rgb_encoder", "warn_if_lossy"]
