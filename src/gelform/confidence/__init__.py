"""The standard deviation of each slope of a frame, the causes that raise it, and the confidence."""

from gelform.confidence.causes import AllAlike, ClippedChannels, PreparedCauses
from gelform.confidence.explanation import Explanation, explanation_of
from gelform.confidence.frame_sigma import PreparedSigma, UnknownSigma, noise_at_rest, with_model_sigma
from gelform.confidence.slope_sigma import SlopeErrors, SlopeSigma, SolvedErrors
from gelform.confidence.solved import SolvedSigma, with_solved_factors
from gelform.confidence.steep import SteepSlopes, all_shown, with_steep

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
