"""Parts of `constants.py`."""
