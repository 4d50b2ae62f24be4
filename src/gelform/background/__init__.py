"""The untouched image: averaged, compared with a frame, checked."""
