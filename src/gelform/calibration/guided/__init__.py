"""Presses of a ball under guidance: the next place, whether a press counts, and the calibration of all."""
