"""Parts of `real_frames.py`."""
