"""What is measured beside the presses: scale, lens, crosstalk."""
