"""gradients -> depth: one method per file, listed in SOLVERS."""

from gelform.solvers.dct import DctSolver

SOLVERS = {"dct": DctSolver}
