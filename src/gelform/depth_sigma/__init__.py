"""How far depth may be off: one standard deviation for each pixel."""
