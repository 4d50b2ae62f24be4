"""The background image: averaged, compared with a frame, checked."""
