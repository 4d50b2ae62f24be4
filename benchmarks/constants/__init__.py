"""Parts of constants.py."""
