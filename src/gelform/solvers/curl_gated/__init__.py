"""Weighted least squares without the pixels whose curl no surface has."""
