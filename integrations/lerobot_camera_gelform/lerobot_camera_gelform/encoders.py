"""LeRobot's lossless video encoders for color."""

from __future__ import annotations

import logging

from lerobot.configs.video import RGBEncoderConfig, rgb_encoder_defaults

logger = logging.getLogger(__name__)
RGB_FORMATS = ("gbrp", "rgb24", "bgr24")  # without conversion to YUV, which rounds
LOSSLESS = {"x265-params": "lossless=1"}


def lossless_rgb_encoder() -> RGBEncoderConfig:
    """Lossless HEVC in RGB: about 48 kB per frame of a GelSight Mini at 240x320; the default takes 0.4 kB."""
    return RGBEncoderConfig(vcodec="hevc", pix_fmt="gbrp", extra_options=dict(LOSSLESS))


def is_lossless(encoder: RGBEncoderConfig) -> bool:
    """Whether the encoder keeps all colors unchanged."""
    x265 = encoder.vcodec == "hevc" and "lossless=1" in str(encoder.extra_options.get("x265-params", ""))
    return encoder.pix_fmt in RGB_FORMATS and (x265 or (encoder.vcodec == "h264" and encoder.crf == 0))


def warn_if_lossy(encoder: RGBEncoderConfig | None = None) -> bool:
    """Log a warning if an encoder loses color, which slopes are read from; return whether it does.

    Parameters
    ----------
    encoder : of a dataset's color images; None: LeRobot's default
    """
    used = rgb_encoder_defaults() if encoder is None else encoder
    if is_lossless(used):
        return False
    logger.warning(
        "The RGB encoder %s, crf %s, %s is lossy: slopes read from the recorded color of a gel are off, with LeRobot's "
        "default by about 1.5 degrees, depth by 17 um. Record with rgb_encoder=lossless_rgb_encoder() of "
        "lerobot_camera_gelform, or with --dataset.rgb_encoder.vcodec=hevc --dataset.rgb_encoder.pix_fmt=gbrp "
        '--dataset.rgb_encoder.extra_options=\'{"x265-params": "lossless=1"}\'. Recorded depth is not concerned.',
        used.vcodec,
        used.crf,
        used.pix_fmt,
    )
    return True
