"""Presses of a ball in, a Calibration out; also starters, the user's library, and the comparison of designs."""
