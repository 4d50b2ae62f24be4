"""Parts of `confidence.py`."""
