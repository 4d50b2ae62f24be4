"""Measures of surfaces: errors of a result against the truth, and roughness."""

from gelform.result.metrics.depth_errors import (
    PressErrors,
    SlopeScore,
    angle_deg,
    press_errors,
    score_slopes,
)
from gelform.result.metrics.roughness import FORMS, Roughness, areal_roughness, gaussian_areal_filter

__all__ = [
    "FORMS",
    "PressErrors",
    "Roughness",
    "SlopeScore",
    "angle_deg",
    "areal_roughness",
    "gaussian_areal_filter",
    "press_errors",
    "score_slopes",
]
