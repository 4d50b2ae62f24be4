"""Parts of strangers.py."""
