"""Parts of `live.py`."""
