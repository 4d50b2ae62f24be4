"""What is wrong with a frame itself, in named findings with figures; a degraded frame is never an exception."""

from gelform.health.frame_health import DepthLimit, FrameFaults, FrameHealth, check_untouched_image

__all__ = ["DepthLimit", "FrameFaults", "FrameHealth", "check_untouched_image"]
