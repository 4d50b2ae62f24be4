"""What presses that a model has not seen say: which settings are chosen, how far off slopes are, how well that is known."""
