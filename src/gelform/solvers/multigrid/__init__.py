"""Weighted least squares by conjugate gradients, preconditioned by black-box multigrid."""
