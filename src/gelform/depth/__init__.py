"""gradients -> depth in millimetres: the doors to the solvers."""

from gelform.depth.integrate import depth_from_gradients, edge_residuals, integrate, integrate_unchecked
from gelform.depth.integration import Integration

__all__ = ["Integration", "depth_from_gradients", "edge_residuals", "integrate", "integrate_unchecked"]
