"""USB cameras: which are plugged in, which one is meant, how they are set, and their frames."""
