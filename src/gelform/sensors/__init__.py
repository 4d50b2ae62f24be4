"""Frames in: image files, and what is known of the sensors that made them."""
