"""Parts of `batch.py`."""
