"""gradients -> depth: one method per file, listed here.

`docs/choosing-a-solver.md` compares them, `docs/adding-a-solver.md` explains how to write one.
"""

from gelform.depth.solvers.dct import Dct4Solver, DctSolver
from gelform.depth.solvers.robust import CurlGatedSolver, RobustSolver
from gelform.depth.solvers.seam import Solution, Solver, Weights
from gelform.depth.solvers.weighted import AtLeastSolver, MultigridSolver, SparseSolver

# SOLVERS[name](shape, mm_per_px) prepares a solver.
SOLVERS: dict[str, type[Solver]] = {
    "dct": DctSolver,
    "dct4": Dct4Solver,
    "multigrid": MultigridSolver,
    "sparse": SparseSolver,
    "robust": RobustSolver,
    "curl_gated": CurlGatedSolver,
    "at_least": AtLeastSolver,
}

__all__ = ["SOLVERS", "Solution", "Solver", "Weights"]
