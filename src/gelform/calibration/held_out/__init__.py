"""Held-out presses: the selection of settings, the errors of slopes, and their uncertainty."""
