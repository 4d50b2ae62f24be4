"""Which color model, chosen on presses that it has not seen."""
