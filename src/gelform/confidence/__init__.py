"""How far each slope of a frame is to be trusted: its standard deviation and the confidence that follows from it."""

from gelform.confidence.frame_sigma import PreparedSigma, UnknownSigma, solved_sigma, with_model_sigma
from gelform.confidence.slope_sigma import SlopeErrors, SlopeSigma, solved_factor

__all__ = [
    "PreparedSigma",
    "SlopeErrors",
    "SlopeSigma",
    "UnknownSigma",
    "solved_factor",
    "solved_sigma",
    "with_model_sigma",
]
