"""Parts of `robots.py`."""
