"""Why gelform integrates by least squares with a free border, and the errors of the usual shortcuts.

Run it with a path to get a picture: python examples/02_why_least_squares.py why.png
"""

import sys
from pathlib import Path

import numpy as np

import gelform

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
from naive_integrators import depth_along_lines, depth_periodic, depth_zero_border
from scenes import BALL, CUT_BALL, rmse_um, scene, with_noise, with_outliers

truth, gradients, pitch = scene(CUT_BALL)


def least_squares(slopes, solver="auto"):
    return gelform.depth_from_gradients(slopes, mm_per_px=pitch, solver=solver)


# 1. Borders cut a ball here, and all slopes are exact. But depth on the border is not 0, nor does left go on at right.
panels = {
    "zero border": (depth_zero_border(gradients, pitch), truth),
    "periodic": (depth_periodic(gradients, pitch), truth),
    "least squares": (least_squares(gradients), truth),
}

# 2. Streaks. Summing along lines is exact on exact slopes. With noise of 0.05 in each slope the errors of all pixels
#    on the way add up, each row on its own; least squares lets all ways through the frame vote.
truth, gradients, pitch = scene(BALL)
noisy = with_noise(gradients, 0.05, np.random.default_rng(0))
panels["lines, noise"] = depth_along_lines(noisy, pitch), truth
panels["least squares, noise"] = least_squares(noisy), truth

# 3. Curl. 15 % of the pixels carry slopes that are wrong and lean one way. Least squares trusts them all and tilts.
#    Around a pixel the slopes of a surface add up to 0, and around these they do not: that finds them.
corrupt = with_outliers(noisy, 0.15, np.random.default_rng(1)).gradients
panels["least squares, outliers"] = least_squares(corrupt), truth
panels["curl_gated, outliers"] = least_squares(corrupt, "curl_gated"), truth

errors_um = {name: rmse_um(depth, true) for name, (depth, true) in panels.items()}
for name, error in errors_um.items():
    print(f"{name:24s} {error:7.2f} um RMS")
assert errors_um["least squares"] < 1.5 < 30 < min(errors_um["zero border"], errors_um["periodic"])
assert errors_um["least squares, noise"] < 5 < 15 < errors_um["lines, noise"]
assert errors_um["curl_gated, outliers"] < 10 < 100 < errors_um["least squares, outliers"]

if len(sys.argv) > 1:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, len(panels), figsize=(2.2 * len(panels), 3.6), layout="constrained")
    for (above, below), (name, (depth, true)) in zip(axes.T, panels.items()):
        above.imshow(depth, cmap="viridis")
        above.set_title(name, fontsize=8)
        below.imshow(1e3 * (depth - true - np.mean(depth - true)), vmin=-100, vmax=100, cmap="RdBu_r")
        below.set_title(f"{errors_um[name]:.3g} um RMS", fontsize=8)
    figure.savefig(sys.argv[1], dpi=90)
