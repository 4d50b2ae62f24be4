"""Presses of a ball in, a Calibration out: contact circles, joint refinement, selection on held-out presses."""

from gelform.calibration.evaluate import Evaluation, evaluate
from gelform.calibration.fit import calibrate

__all__ = ["Evaluation", "calibrate", "evaluate"]
