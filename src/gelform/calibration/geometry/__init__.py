"""Measurements apart from the presses, written where `read_presses` finds them: scale, lens, crosstalk."""
