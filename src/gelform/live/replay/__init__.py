"""Recordings played on the page: any frame at hand, at any speed, with what is needed to share it."""
