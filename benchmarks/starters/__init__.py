"""Parts of starters.py."""
