"""The figure of paper/paper.md, and every figure that it quotes, as the results have them.

    python benchmarks/paper.py             # draws paper/figure.png, from a simulated sensor: a minute
    python benchmarks/paper.py --quotes    # prints the quotes

tests/benchmarks/test_scripts.py holds the text to the quotes, and lets no other figure in.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import gelform
from gelform.simulate import LAYOUTS, Coin, simulate_ball_presses, simulate_press
from report import RESULTS, command_line

PAPER = Path(__file__).parents[1] / "paper"
SEED, PRESSES, DEPTH_MM = 0, 24, 0.35
PANELS = 4


def quotes() -> list[str]:
    """Each figure of the paper in the words around it."""
    accuracy, speed, starters = (_results(name) for name in ("accuracy", "speed", "starters"))
    peers = json.loads((RESULTS.parent / "peers.json").read_bytes())
    real, few, simulated = accuracy["real"], accuracy["few"], accuracy["simulated"]
    within = "slopes within 1 sigma, %"
    halves = [accuracy["sigma"][within], accuracy["sigma"]["odd presses calibrate, even ones judge"][within]]
    screws, cut = (
        [of[name]["peak_percent"] for of in simulated.values()]
        for name in ("screw", "ball cut by the border")
    )
    frame = speed["sizes"]["240x320"]["whole frame, everything on"]
    unit = starters["units"]["mini-d, the starter made of mini-ball"]
    return [
        *_integrators(peers["recovered_peak_percent"], accuracy["integrators"]["recovered_peak_percent"]),
        *_presses(real, peers["real_presses"]),
        f"{accuracy['whole']['all presses']['accepted']} presses of two balls",
        f"{halves[0]:.0f} % and {halves[1]:.0f} % of the slopes lie within the stated standard deviation; 68 % is right",
        f"inside the contact edge is {real['digit-ball']['edge_deg']:.1f} degrees",
        f"reaches {unit['edge_deg']:.1f} degrees there on a second GelSight Mini",
        f"A frame of 240x320 takes {frame['ms']:.1f} ms of one thread, {frame['D']:.1f} times a bare",
        f"simulated screws keep {min(screws):.0f} to {max(screws):.0f} %",
        f"keeps {min(cut):.0f} to {max(cut):.0f} %",
        f"Ten presses give {few['10']['edge_deg']:.1f} degrees inside the contact edge, twenty {few['20']['edge_deg']:.1f}.",
    ]


def _integrators(peers: Any, ours: Any) -> list[str]:
    """Rows of the table of integrators."""
    return [
        f"| {name} | {' | '.join(map(str, of.values()))} | {ours[name]:.2f} |" for name, of in peers.items()
    ]


def _presses(real: Any, peers: Any) -> list[str]:
    """Rows of the table of held-out errors."""
    splits = {
        "every second press calibrates, the others test": real["mini-ball, every second press calibrates"],
        "the others calibrate, every second press tests": real["mini-ball, the others calibrate"],
        "6.31 mm ball calibrates, 9.50 mm ball tests": real["mini-ball, 6.31 mm calibrates"],
        "9.50 mm ball calibrates, 6.31 mm ball tests": real["mini-ball, 9.50 mm calibrates"],
    }
    rows = [
        f"| {name} | {of['rim_deg']:.1f} | {of['radius_percent']:.1f} | {of['cap_um']:.0f} | {of['off_contact_um']:.1f} |"
        for name, of in splits.items()
    ]
    name = "gs_sdk, as shipped, trained on the test presses too"
    theirs = [
        peers[name][key] for key in ("normal_free_deg", "radius_percent", "cap_free_um", "off_contact_um")
    ]
    return [*rows, f"| {name.replace('gs_sdk,', 'gs_sdk')} | {' | '.join(map(str, theirs))} |"]


def _results(name: str) -> Any:
    return json.loads((RESULTS / f"{name}.json").read_bytes())


def draw(path: Path) -> None:
    """A simulated press of a relief: image, depth, its error and its standard deviation."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rng, sensor = np.random.default_rng(SEED), LAYOUTS["three-edges"]
    with tempfile.TemporaryDirectory() as folder:
        presses = simulate_ball_presses(sensor, ball_diameters_mm=[5, 8], count=PRESSES, rng=rng)
        saved = gelform.save_simulated_presses(Path(folder) / "presses", presses)
        calibration = gelform.calibrate(gelform.read_presses(saved))
    press = simulate_press(sensor, Coin(), depth_mm=DEPTH_MM, rng=rng)
    result = gelform.Reconstructor(calibration)(press.image)
    error_um = 1e3 * (result.depth_mm - press.depth_mm)
    figure, axes = plt.subplots(1, PANELS, figsize=(10, 2.1), layout="constrained")
    axes[0].imshow(press.image)
    rms = float(np.sqrt(np.mean(error_um**2)))
    maps = (
        (result.depth_mm, "depth, mm", {"cmap": "viridis"}),
        (error_um, f"error, um ({rms:.1f} RMS)", {"cmap": "RdBu_r", "vmin": -60, "vmax": 60}),
        (
            1e3 * result.depth_sigma_mm,
            "stated standard deviation, um",
            {"cmap": "magma", "vmin": 0, "vmax": 60},
        ),
    )
    for axis, (values, _, how) in zip(axes[1:], maps):
        figure.colorbar(axis.imshow(values, **how), ax=axis, shrink=0.9)
    for axis, title in zip(axes, ("image", *(title for _, title, _ in maps))):
        axis.set_title(title, fontsize=9)
        axis.set(xticks=[], yticks=[])
    figure.savefig(path, dpi=150, metadata={"Software": None})


def main() -> None:
    """Draw the figure, or print the quotes."""
    parser = command_line(__doc__)
    parser.add_argument("--quotes", action="store_true", help="print the quotes and draw nothing")
    if parser.parse_args().quotes:
        print("\n".join(quotes()))
        return
    draw(PAPER / "figure.png")


if __name__ == "__main__":
    main()
