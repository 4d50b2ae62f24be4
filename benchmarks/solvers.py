"""The solvers' tables and picture: accuracy, outliers, noise, sigma, speed, memory, first start.

    python benchmarks/solvers.py [--quick] [--only WORD] [-o benchmarks/results]
    python benchmarks/solvers.py --pictures docs/images     # draws the pictures of docs/choosing-a-solver.md instead

Times are CPU times of one thread, 10 % quantile, as ratios to D: a bare float32 scipy.fft dctn + idctn pair of the
same size. Both are measured alternately, so that a busy machine affects both.
"""

from __future__ import annotations

import argparse
import json
import platform
import resource
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.fft import dctn, idctn

import gelform
from gelform.depth.solvers import SOLVERS, MultigridSolver, SparseSolver
from gelform.depth.solvers.multigrid import Grid
from gelform.depth.solvers.system import problem_from_gradients
from presses import DATA
from scenes import (
    BALL,
    BALLS,
    MM_PER_PX,
    PEAKS,
    SCENES,
    SHAPE,
    confidence_from_valid,
    rmse_um,
    scene,
    with_noise,
    with_outliers,
    with_patches,
)
from solvers.times import ratio, start_and_memory

NOISE = 0.05
SIZES = [(240, 320), (480, 640), (960, 1280), (2048, 2048)]
Table = dict[str, dict[str, float]]


def depth_of(name: str, gradients: Any, **arguments: Any) -> Any:
    return gelform.depth_from_gradients(gradients, mm_per_px=MM_PER_PX, solver=name, **arguments)


def accuracy() -> Table:
    """RMSE in um without noise."""
    table: Table = {}
    for name in SOLVERS:
        table[name] = {}
        for title in ("ball", "balls", "peaks", "texture", "plane"):
            sample = scene(SCENES[title])
            table[name][title] = rmse_um(depth_of(name, sample.gradients), sample.depth_mm)
    return table


def noise(repeats: int) -> Table:
    """RMSE in um at several slope noises, and as a multiple of the closed form's."""
    sample = scene(PEAKS)
    table: Table = {}
    for name in SOLVERS:
        if name == "sparse":
            continue
        table[name] = {}
        for sigma in (0.01, 0.05, 0.2):
            errors = [
                rmse_um(
                    depth_of(name, with_noise(sample.gradients, sigma, np.random.default_rng(k))),
                    sample.depth_mm,
                )
                for k in range(repeats)
            ]
            floor = 1e3 * np.sqrt(
                np.mean(
                    gelform.depth_sigma_from_gradients_sigma(np.full((*SHAPE, 2), sigma), mm_per_px=MM_PER_PX)
                    ** 2
                )
            )
            table[name][f"{sigma:g}"] = float(np.sqrt(np.mean(np.square(errors))))
            table[name][f"{sigma:g} / floor"] = table[name][f"{sigma:g}"] / float(floor)
    return table


def lies(repeats: int) -> Table:
    """RMSE in um with 15 % outliers and slope noise 0.05: specks, and coherent patches."""
    table: Table = {}
    for corrupt, kind in ((with_outliers, "specks"), (with_patches, "patches")):
        for title, surface in (("ball", BALL), ("balls", BALLS)):
            sums: dict[str, list[float]] = {}
            for k in range(repeats):
                rng = np.random.default_rng(k)
                sample = scene(surface)
                corrupt = corrupt(with_noise(sample.gradients, NOISE, rng), 0.15, rng)
                for name in ("dct", "robust_huber", "robust", "robust_l1", "curl_gated"):
                    error = rmse_um(depth_of(name, corrupt.gradients), sample.depth_mm)
                    sums.setdefault(name, []).append(error)
                known = depth_of("multigrid", corrupt.gradients, weights=corrupt.valid.astype(np.float32))
                sums.setdefault("known, valid pixels", []).append(
                    rmse_um(known, sample.depth_mm, corrupt.valid)
                )
                sums.setdefault("known, all pixels", []).append(rmse_um(known, sample.depth_mm))
            for name, errors in sums.items():
                table.setdefault(name, {})[f"{kind}, {title}"] = float(np.sqrt(np.mean(np.square(errors))))
    return table


def frame_with_outliers(shape: tuple[int, int], kind: str) -> tuple[Any, Any, tuple[float, float], Any]:
    """Slopes with 10 % outliers and confidence from 1 to 1e-3."""
    sample = scene(PEAKS, shape, MM_PER_PX * SHAPE[0] / shape[0])
    rng = np.random.default_rng(0)
    corrupt = with_outliers if kind == "specks" else with_patches
    corrupt = corrupt(with_noise(sample.gradients, NOISE, rng), 0.1, rng)
    weights = confidence_from_valid(corrupt.valid, low=1.001e-3).astype(np.float32)
    return corrupt.gradients.astype(np.float32), weights, sample.mm_per_px, sample.depth_mm


def speed(sizes: list[tuple[int, int]]) -> Table:
    """Times as ratios to D."""
    table: Table = {}
    for shape in sizes:
        repeats = max(5, int(4e6 / (shape[0] * shape[1])))
        picture = np.random.default_rng(0).standard_normal(shape).astype(np.float32)

        def bare(picture: Any = picture) -> Any:
            return idctn(dctn(picture))

        size = f"{shape[0]}x{shape[1]}"
        for name in [name for name, solver in SOLVERS.items() if not solver.takes_weights]:
            gradients, _, pitch, _ = frame_with_outliers(shape, "specks")
            solver = SOLVERS[name](shape, pitch)
            table.setdefault(name, {})[size], ms = ratio(partial(solver, gradients), bare, repeats)
            if name == "dct":
                table.setdefault("dct, ms", {})[size] = ms
                door = partial(gelform.depth_from_gradients, gradients, mm_per_px=pitch)
                table.setdefault("dct, through the door", {})[size] = ratio(door, bare, repeats)[0]
        for kind in ("specks", "patches"):
            timed_weighted(table, shape, kind, bare, repeats)
        gradients, _, pitch, _ = frame_with_outliers(shape, "specks")
        if shape[0] <= 960:
            for name in ("robust", "curl_gated"):
                solver = SOLVERS[name](shape, pitch)
                table.setdefault(name, {})[size] = ratio(
                    partial(solver, gradients), bare, max(5, repeats // 3)
                )[0]
    return table


def timed_weighted(
    table: Table, shape: tuple[int, int], kind: str, bare: Callable[[], Any], repeats: int
) -> None:
    """Setup and solve of `multigrid`, its iterations, and its error against `sparse` where that is feasible."""
    gradients, weights, pitch, depth = frame_with_outliers(shape, kind)
    size = f"{shape[0]}x{shape[1]}"
    grid = Grid(shape)
    anchors = {"": None, ", anchored": np.where(depth < 0.05, 1e-2, 0).astype(np.float32)}
    for title, anchor in anchors.items():
        problem = problem_from_gradients(gradients, weights, None, anchor)

        def work(problem: Any = problem) -> Any:
            grid.load(problem, pitch)
            grid.build()
            return grid.solve(4e-4, 1000)

        name = f"multigrid, {kind}{title}"
        table.setdefault(name, {})[size], ms = ratio(work, bare, max(5, repeats // 3))
        table.setdefault(f"{name}, iterations", {})[size] = work()[1]
        if not title:
            table.setdefault(f"{name}, ms", {})[size] = ms

            def door() -> Any:
                return MultigridSolver(shape, pitch)(gradients, weights)

            table.setdefault(f"{name}, unprepared", {})[size] = ratio(door, bare, 5)[0]
        if shape[0] <= 480:
            exact = SparseSolver(shape, pitch)(gradients, weights, None, anchor).depth_mm
            difference = (work()[0] - exact).astype(np.float64)
            difference -= 0 if title else difference.mean()
            table.setdefault(f"{name}, max error um", {})[size] = float(1e3 * np.abs(difference).max())


def growth(table: Table) -> Table:
    """Exponent of the number of pixels in the growth of times."""
    powers: Table = {"growth": {}}
    for name, end in (("dct, ms", "960x1280"), ("multigrid, patches, ms", "2048x2048")):
        if end in table.get(name, {}):
            pixels = [np.prod([int(n) for n in size.split("x")]) for size in ("240x320", end)]
            times = [table[name][size] for size in ("240x320", end)]
            powers["growth"][f"{name} 240x320 to {end}"] = float(
                np.diff(np.log(times))[0] / np.diff(np.log(pixels))[0]
            )
    return powers


def uncertainty(count: int, probes: tuple[int, ...] = (16, 32, 64)) -> Table:
    """Map of the standard deviation, weighted, white and correlated, against full Monte Carlo; its time once prepared."""
    table: Table = {}
    for length in (0, 10, 20):
        expected = monte_carlo_sigma(length, count)
        for n in probes:
            prepared = gelform.DepthSigma(SHAPE, mm_per_px=MM_PER_PX, correlation_px=length, probes=n)
            for title, (sigma, arguments) in sigma_frames().items():
                off = np.abs(prepared(sigma, **arguments) / expected[title] - 1)
                row = table.setdefault(f"{title}, {n} probes", {})
                row[f"{length} px: median"] = float(np.median(off))
                row[f"{length} px: 95 %"] = float(np.quantile(off, 0.95))
    picture = np.zeros(SHAPE, dtype=np.float32)
    sigma, arguments = sigma_frames()["contact 80 px, specks"]
    for n in probes:
        prepared = gelform.DepthSigma(SHAPE, mm_per_px=MM_PER_PX, correlation_px=20, probes=n)
        work = partial(prepared, sigma, **arguments)
        table[f"contact 80 px, specks, {n} probes"]["time / D"] = ratio(
            work, lambda: idctn(dctn(picture)), 100
        )[0]
    return table


def sigma_frames() -> dict[str, tuple[Any, dict[str, Any]]]:
    """Slope sigma, weights and anchor: anchored around a contact, with specks or patches, or nowhere."""
    rng = np.random.default_rng(5)
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]

    def disc(row: float, col: float, radius: float) -> Any:
        return np.hypot(rows - row, cols - col) < radius

    def anchored(row: float, col: float, radius: float) -> Any:
        return np.where(disc(row, col, radius), 0, 1e-2).astype(np.float32)

    even = np.full(SHAPE, NOISE, dtype=np.float32)
    specks, patches = even.copy(), even.copy()
    bad = rng.uniform(size=SHAPE) < 0.1
    specks[bad] = 10 ** rng.uniform(np.log10(0.06), np.log10(0.9), np.count_nonzero(bad))
    for _ in range(25):
        where = disc(rng.uniform(0, SHAPE[0]), rng.uniform(0, SHAPE[1]), rng.uniform(5, 15))
        patches[where] = 10 ** rng.uniform(np.log10(0.1), np.log10(0.7))
    uneven = (even * np.exp(0.3 * rng.standard_normal(SHAPE))).astype(np.float32)
    uneven[:, :120] *= 1.8
    frames = {
        "contact 40 px": (even, anchored(100, 130, 40)),
        "contact 80 px, specks": (specks, anchored(120, 170, 80)),
        "contact 60 px, patches": (patches, anchored(110, 150, 60)),
        "no anchor, uneven": (uneven, None),
    }
    return {
        title: (sigma, {"weights": np.minimum(1, (NOISE / sigma) ** 2).astype(np.float32), "anchor": anchor})
        for title, (sigma, anchor) in frames.items()
    }


def monte_carlo_sigma(length: float, count: int) -> dict[str, Any]:
    """Standard deviation of full solutions; with a length, half of the variance is correlated."""
    rng = np.random.default_rng(1)
    frames = sigma_frames()
    total = {title: np.zeros(SHAPE) for title in frames}
    for _ in range(count):
        errors = rng.standard_normal((*SHAPE, 2))
        if length:
            errors = np.sqrt(0.5) * (errors + correlated_errors(SHAPE, length, rng))
        for title, (sigma, arguments) in frames.items():
            depth = depth_of("multigrid", sigma[..., None] * errors, **arguments)
            total[title] += depth.astype(np.float64) ** 2
    return {title: np.sqrt(square / count) for title, square in total.items()}


def correlated_errors(shape: tuple[int, int], length: float, rng: np.random.Generator) -> Any:
    """Errors of variance 1 with correlation exp(-d^2/(2 length^2))."""
    from scipy.ndimage import gaussian_filter

    blur = length / np.sqrt(2)
    margin = int(5 * blur) + 1
    noise = rng.standard_normal((shape[0] + 2 * margin, shape[1] + 2 * margin, 2))
    impulse = np.zeros(2 * margin + 1)
    impulse[margin] = 1
    gain = np.sum(gaussian_filter(impulse, blur) ** 2)
    return gaussian_filter(noise, (blur, blur, 0))[margin:-margin, margin:-margin] / gain


def groove() -> Table:
    """Gradients of the measured groove, integrated: largest error as a fraction of the range."""
    folder = DATA / "groove"
    files = sorted(folder.glob("*.np[yz]")) if folder.is_dir() else []
    if not files:
        return {}
    loaded = np.load(files[0])
    depth = np.asarray(
        loaded if isinstance(loaded, np.ndarray) else loaded[loaded.files[0]], dtype=np.float64
    )
    gradients = gelform.gradients_from_depth(depth, mm_per_px=0.02746)
    table: Table = {}
    for name in ("dct", "dct4", "multigrid"):
        found = gelform.depth_from_gradients(gradients, mm_per_px=0.02746, solver=name)
        difference = found - depth
        table[name] = {
            "RMS, share of range": float(np.std(difference) / np.ptp(depth)),
            "largest, share of range": float(np.abs(difference - difference.mean()).max() / np.ptp(depth)),
        }
    return table


def pictures() -> Any:
    """The module that draws, if matplotlib is installed."""
    try:
        from solvers import pictures
    except ImportError as error:
        raise SystemExit(
            "Expected matplotlib for the picture. Install the extra: pip install gelform[plots]."
        ) from error
    return pictures


def shown(title: str, table: Table) -> None:
    columns = list(dict.fromkeys(column for row in table.values() for column in row))
    width = max([len(name) for name in table] + [1])
    print(f"\n{title}\n\n| {'':{width}} | " + " | ".join(columns) + " |")
    print(f"|{'-' * (width + 2)}|" + "|".join("-" * (len(c) + 1) + ":" for c in columns) + "|")
    for name, row in table.items():
        cells = [f"{row[c]:.3g}" if c in row else "" for c in columns]
        print(f"| {name:{width}} | " + " | ".join(f"{v:>{len(c)}}" for v, c in zip(cells, columns)) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="fewer repeats, up to 480x640")
    parser.add_argument("--only", help="measure the tables whose title contains this; keep the others")
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument(
        "--pictures", type=Path, metavar="FOLDER", help="draw those of docs/choosing-a-solver.md"
    )
    options = parser.parse_args()
    if options.pictures:
        pictures().draw_failures(options.pictures)
        return
    few = 2 if options.quick else 5
    results: dict[str, Table] = {}
    tables: dict[str, Callable[[], Table]] = {
        "RMSE, um, without noise, 240x320": accuracy,
        "RMSE, um, at slope noise (peaks)": lambda: noise(few),
        "RMSE, um, 15 % of the pixels lie, slope noise 0.05": lambda: lies(few),
        "Measured groove, there and back": groove,
        "Standard deviation of depth against Monte Carlo": lambda: uncertainty(100 if options.quick else 400),
        "Time / D (ms: absolute)": lambda: speed(SIZES[: 2 if options.quick else 4]),
        "Start and memory": lambda: start_and_memory(not options.quick),
    }
    path = options.output / "solvers.json"
    if options.only:
        tables = {title: make for title, make in tables.items() if options.only in title}
        results = json.loads(path.read_text())["tables"]
    for title, make in tables.items():
        results[title] = make()
        shown(title, results[title])
    results["Growth: power of the pixels"] = growth(results["Time / D (ms: absolute)"])
    shown("Growth: power of the pixels", results["Growth: power of the pixels"])
    options.output.mkdir(parents=True, exist_ok=True)
    about = {"machine": platform.machine(), "python": platform.python_version(), "numpy": np.__version__}
    path.write_text(json.dumps({"about": about, "tables": results}, indent=1) + "\n")
    if not options.only:
        pictures().draw_errors_and_times(options.output / "solvers.png")
    print(f"\npeak memory of this process {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
