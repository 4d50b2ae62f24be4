"""Presses of a ball in, a Calibration out: contact circles, joint refinement, selection on held-out presses."""
