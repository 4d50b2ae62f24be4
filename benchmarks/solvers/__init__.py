"""Parts of `solvers.py`."""
