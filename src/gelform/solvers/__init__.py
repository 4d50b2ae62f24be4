"""gradients -> depth: one method per file, listed here."""

from gelform.solvers.dct import DctSolver
from gelform.solvers.multigrid import MultigridSolver
from gelform.solvers.sparse import SparseSolver

# solver(gradients) -> depth
UNIFORM = {"dct": DctSolver}
# solver(gradients, weights, mask, anchor) -> Solution
WEIGHTED = {"multigrid": MultigridSolver, "sparse": SparseSolver}
SOLVERS = {**UNIFORM, **WEIGHTED}
