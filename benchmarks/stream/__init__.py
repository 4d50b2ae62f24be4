"""Parts of `stream.py`."""
