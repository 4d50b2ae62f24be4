"""The standard deviation of each slope of a frame: a budget of named variances, and the confidence that follows."""

from gelform.slopes.confidence.budget import Budget, PreparedBudget, ReadSlopes, noise_at_rest, without_bias
from gelform.slopes.confidence.causes import ClippedChannels
from gelform.slopes.confidence.explanation import Explanation, explanation_of
from gelform.slopes.confidence.slope_sigma import SlopeErrors, SlopeSigma

__all__ = [
    "Budget",
    "ClippedChannels",
    "Explanation",
    "PreparedBudget",
    "ReadSlopes",
    "SlopeErrors",
    "SlopeSigma",
    "explanation_of",
    "noise_at_rest",
    "without_bias",
]
