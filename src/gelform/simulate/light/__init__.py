"""Lights, shadows and coating: what the surface looks like."""
