"""gradients -> depth: one method per file, listed here.

`docs/choosing-a-solver.md` says which to take, `docs/adding-a-solver.md` how to write one.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from gelform.solvers.curl_gated.solver import GatedSolver
from gelform.solvers.dct import DctSolver
from gelform.solvers.dst import DstSolver
from gelform.solvers.fourier import FourierSolver
from gelform.solvers.multigrid.solver import MultigridSolver
from gelform.solvers.path import PathSolver
from gelform.solvers.robust import RobustSolver
from gelform.solvers.sparse import SparseSolver

# SOLVERS[name](shape, mm_per_px) prepares a solver.

# These treat all slopes alike: solver(gradients) -> depth, of a frame or a stack.
UNIFORM: dict[str, Callable[..., Any]] = {
    "dct": DctSolver,
    "dct4": partial(DctSolver, order=4),
    "path": PathSolver,
    "fourier": FourierSolver,
    "dst": DstSolver,
}
# These take weights: solver(gradients, weights, mask, anchor) -> Solution, of one frame.
WEIGHTED: dict[str, Callable[..., Any]] = {
    "multigrid": MultigridSolver,
    "sparse": SparseSolver,
    "robust": RobustSolver,
    "robust_huber": partial(RobustSolver, loss="huber"),
    "robust_l1": partial(RobustSolver, loss="l1"),
    "gated": GatedSolver,
}
SOLVERS = {**UNIFORM, **WEIGHTED}
