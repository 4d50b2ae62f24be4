"""The pictures of docs/choosing-a-solver.md: one for each way in which integration fails; and error against time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.fft import dctn, idctn

import gelform
from gelform.depth.solvers import SOLVERS, RobustSolver
from scenes import BALL, BALLS, MM_PER_PX, SHAPE, rmse_um, scene, with_noise, with_outliers
from solvers.naive_integrators import NAIVE, depth_along_lines
from solvers.times import ratio

Panels = dict[str, Any]


def depth_of(gradients: Any, solver: str = "dct", **arguments: Any) -> Any:
    return gelform.depth_from_gradients(gradients, mm_per_px=MM_PER_PX, solver=solver, **arguments)


def noise() -> tuple[Any, Panels]:
    truth, gradients, _ = scene(BALL)
    noisy = with_noise(gradients, 0.05, np.random.default_rng(0))
    pitch = MM_PER_PX, MM_PER_PX
    return truth, {"line by line": depth_along_lines(noisy, pitch), "dct": depth_of(noisy)}


def outliers() -> tuple[Any, Panels]:
    truth, gradients, _ = scene(BALL)
    rng = np.random.default_rng(0)
    corrupt = with_outliers(with_noise(gradients, 0.05, rng), 0.15, rng)
    panels = {name: depth_of(corrupt.gradients, name) for name in ("dct", "robust", "curl_gated")}
    panels["multigrid, known"] = depth_of(corrupt.gradients, "multigrid", weights=corrupt.valid * 1.0)
    return truth, panels


def border() -> tuple[Any, Panels]:
    truth, gradients, _ = scene(BALLS)
    naive = {name: NAIVE[name](gradients, (MM_PER_PX, MM_PER_PX)) for name in ("zero border", "periodic")}
    return truth, naive | {"dct": depth_of(gradients)}


def hole() -> tuple[Any, Panels]:
    """A highlight: slopes in a disc of 25 px are wrong."""
    truth, gradients, _ = scene(BALL)
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    hidden = (rows - 105) ** 2 + (cols - 185) ** 2 < 25**2
    gradients[hidden] = (0.8, -0.4)
    weights = np.where(hidden, 0.0, 1.0)
    return truth, {
        "dct": depth_of(gradients),
        "multigrid, weight 0 there": depth_of(gradients, "multigrid", weights=weights),
    }


def wall() -> tuple[Any, Panels]:
    """A step of 0.5 mm, one pixel wide: steeper than a slope of 1, the sensor's limit."""
    truth = np.zeros(SHAPE)
    truth[70:170, 100:220] = 0.5
    gradients = np.clip(gelform.gradients_from_depth(truth, mm_per_px=MM_PER_PX), -1, 1)
    panels = {name: depth_of(gradients, name) for name in ("dct", "robust_l1", "curl_gated")}
    return truth, panels


def draw(truth: Any, panels: Panels, path: Path) -> None:
    """Draw the truth, then for each solver the depth and its error below."""
    figure, axes = plt.subplots(
        2, len(panels) + 1, figsize=(2.6 * (len(panels) + 1), 4.1), layout="constrained"
    )
    errors = {name: 1e3 * (depth - truth - np.mean(depth - truth)) for name, depth in panels.items()}
    limit = max(np.quantile(np.abs(error), 0.99) for error in errors.values())
    low, high = truth.min() - 0.05, truth.max() + 0.05
    axes[0, 0].imshow(truth, vmin=low, vmax=high, cmap="viridis")
    axes[0, 0].set_title("true depth", fontsize=9)
    axes[1, 0].axis("off")
    for column, (name, depth) in enumerate(panels.items(), start=1):
        shown = depth - np.mean(depth - truth)
        axes[0, column].imshow(shown, vmin=low, vmax=high, cmap="viridis")
        axes[0, column].set_title(name, fontsize=9)
        picture = axes[1, column].imshow(errors[name], vmin=-limit, vmax=limit, cmap="RdBu_r")
        axes[1, column].set_title(f"error, RMSE {rmse_um(depth, truth):.3g} um", fontsize=9)
    figure.colorbar(picture, ax=axes[1, 1:], label="um", shrink=0.9)
    for axis in axes.ravel():
        axis.set_xticks([])
        axis.set_yticks([])
    figure.savefig(path, dpi=80)
    plt.close(figure)


def draw_failures(folder: Path) -> None:
    """Draw all pictures, into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for make in (noise, outliers, border, hole, wall):
        truth, panels = make()
        draw(truth, panels, folder / f"solver-{make.__name__}.png")
        print(make.__name__, {name: round(rmse_um(depth, truth), 2) for name, depth in panels.items()})


def draw_errors_and_times(path: Path) -> None:
    """Error against time at 240x320: 15 % specks and slope noise 0.05 on the ball."""
    rng = np.random.default_rng(0)
    sample = scene(BALL)
    corrupt = with_outliers(with_noise(sample.gradients, 0.05, rng), 0.15, rng)
    gradients = corrupt.gradients.astype(np.float32)
    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    runs: dict[str, Callable[[], Any]] = {
        name: lambda name=name: depth_of(gradients, name)
        for name in SOLVERS
        if name not in ("multigrid", "sparse")
    }
    weights = corrupt.valid.astype(np.float32)
    runs["multigrid, known confidence"] = lambda: depth_of(gradients, "multigrid", weights=weights)
    runs["sparse, known confidence"] = lambda: depth_of(gradients, "sparse", weights=weights)
    for rounds in (1, 5):
        solver = RobustSolver(SHAPE, (MM_PER_PX, MM_PER_PX), rounds=rounds)
        runs[f"robust, {rounds} rounds"] = lambda solver=solver: solver(gradients).depth_mm
    picture = gradients[..., 0].copy()
    for name, work in runs.items():
        cost = ratio(work, lambda: idctn(dctn(picture)), 5)[0]
        error = rmse_um(work(), sample.depth_mm)
        axes.loglog(cost, error, "o", color="tab:orange" if "known" in name else "tab:blue")
        axes.annotate(name, (cost, error), xytext=(5, 3), textcoords="offset points", fontsize=8)
    axes.set(
        xlabel="time / time of a bare DCT pair (240x320)",
        ylabel="RMSE of depth (um)",
        title="Ball, slope noise 0.05, 15 % of the pixels lie (orange: it is known which)",
    )
    axes.grid(True, which="both", alpha=0.25)
    axes.set_xlim(right=8e3)
    figure.savefig(path, dpi=110)
    plt.close(figure)
