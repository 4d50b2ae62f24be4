"""Files for other programs, and of simulated presses; folders appear complete or not at all."""
