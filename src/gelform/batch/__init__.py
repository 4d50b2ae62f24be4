"""Data sets in, data sets out."""
