"""What is measured apart from the presses, and written where `read_presses` finds it: scale, lens, crosstalk."""
