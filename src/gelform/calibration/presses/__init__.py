"""Presses in, from folders, other packages' layouts and videos: a press set."""
