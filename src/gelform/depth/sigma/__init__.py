"""The standard deviation of depth for each pixel."""
