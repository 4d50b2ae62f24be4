"""A frame and its coarser levels, in C: couplings, right side, and the iteration that solves for depth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform._native import Handle, Kernel

_load = Kernel(
    "multigrid_load",
    "multigrid* grid, f32[h,w,2] gradients, f32[h,w] confidence, f32[h,w]? anchor, f32 hx, f32 hy",
)
_load_edges = Kernel(
    "multigrid_load_edges",
    "multigrid* grid, f32[h,edges] east, f32[rows,w] south, f32[h,w] anchor, f32[h,w] right",
)
_build = Kernel("multigrid_build", "multigrid* grid")
_solve = Kernel(
    "multigrid_solve",
    "multigrid* grid, f32[h,w]? start, out f32[h,w] depth, f64 whole, f64 tolerance, i32 limit, out f64[2] report",
)
_plane = Kernel("multigrid_plane", "multigrid* grid, i32 level, i32 plane, out f32[h,w] values")


class Grid:
    def __init__(self, shape, isa=None):
        self.shape = shape
        self.handle = Handle("multigrid", *shape)
        self.load_, self.build_, self.solve_ = _load, _build, _solve
        if isa: self.load_, self.build_, self.solve_ = (k.on(isa) for k in (_load,_build,_solve))

    def load(self, g, c, a, pitch):
        return self.load_(self.handle, g, c, a, *pitch)

    def solve(self, tol=4e-4, limit=1000, start=None, whole=0.0):
        depth = np.empty(self.shape, np.float32); report=np.zeros(2)
        status = self.solve_(self.handle, start, depth, whole, tol, limit, report)
        return depth, int(report[0]), report[1], status
