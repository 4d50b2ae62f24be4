"""What a simulated sensor is, and what its camera makes of light."""
