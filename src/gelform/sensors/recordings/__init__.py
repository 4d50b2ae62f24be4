"""Recordings of a camera without change, as MCAP files (extra `mcap`), and playing a film."""
