"""The standard deviation of each slope of a frame, the causes that raise it, and the confidence."""

from gelform.slopes.confidence.causes import AllAlike, ClippedChannels, PreparedCauses
from gelform.slopes.confidence.explanation import Explanation, explanation_of
from gelform.slopes.confidence.frame_sigma import PreparedSigma, UnknownSigma, noise_at_rest, with_model_sigma
from gelform.slopes.confidence.slope_sigma import SlopeErrors, SlopeSigma, SolvedErrors
from gelform.slopes.confidence.solved import SolvedSigma, with_solved_factors
from gelform.slopes.confidence.steep import SteepSlopes, all_shown, with_steep

__all__ = [
    "AllAlike",
    "ClippedChannels",
    "Explanation",
    "PreparedCauses",
    "PreparedSigma",
    "SlopeErrors",
    "SlopeSigma",
    "SolvedErrors",
    "SolvedSigma",
    "SteepSlopes",
    "UnknownSigma",
    "all_shown",
    "explanation_of",
    "noise_at_rest",
    "with_model_sigma",
    "with_solved_factors",
    "with_steep",
]
