"""Indenters, and their poses."""
