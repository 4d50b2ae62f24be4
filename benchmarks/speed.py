"""How fast it is: every stage of a frame, and the whole frame, one thread, at three sizes.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/speed.py        # about a minute

Machines are shared and noisy: trust the ratios to D, a bare float32 scipy dctn + idctn pair of the same size that is
timed in turn with the stages in the same run. Writes results/speed.json.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

import gelform
from gelform.anchor import RestAnchor
from gelform.background.change import PreparedBackground
from gelform.background.untouched import untouched_from_color_change
from gelform.calibration.presses.folder import Press, Presses
from gelform.confidence import PreparedSigma
from gelform.contact import contact_from_depth
from gelform.simulate import LAYOUTS, Ball, simulate_ball_presses, simulate_press
from gelform.view import View
from report import dct_pair, median_ms, table, write

SIZES = ((240, 320), (480, 640), (960, 1280))


def calibration_at(shape: tuple[int, int]) -> tuple[gelform.Calibration, np.ndarray]:
    """A calibrated simulated sensor of that size, and an image of a press."""
    scale = shape[0] / 120
    small = replace(LAYOUTS["three-edges"], shape=(120, 160), mm_per_px=0.1268)
    simulated = simulate_ball_presses(
        small, ball_diameters_mm=[5.0, 8.0], count=24, rng=np.random.default_rng(0), oversample=1
    )
    size = (shape[1], shape[0])
    presses = tuple(
        Press(
            str(i), cv2.resize(p.image, size, interpolation=cv2.INTER_CUBIC), p.ball_diameter_mm, None, str(i)
        )
        for i, p in enumerate(simulated.presses)
    )
    background = cv2.resize(simulated.background, size, interpolation=cv2.INTER_CUBIC).astype(np.float32)
    folder = Presses("simulated", presses, background, small.mm_per_px / scale, None, "s", None, None, View())
    calibration = gelform.calibrate(folder, color_model="polynomial")
    press = simulate_press(small, Ball(3.0), depth_mm=0.6, rng=np.random.default_rng(1))
    return calibration, cv2.resize(press.image, size, interpolation=cv2.INTER_CUBIC)


def with_full_polynomial(calibration: gelform.Calibration) -> gelform.Calibration:
    """The same with the largest polynomial that calibration tries, whatever it chose for this sensor."""
    from gelform.color_models import PolynomialModel
    from gelform.color_models._shared.least_squares import monomials, position_powers

    degrees = (4, 3, 1)
    count = sum(len(position_powers(degrees[len(term) - 1])) for term in monomials(3, 3))
    coefficients = np.random.default_rng(0).normal(0, 1e-3, (count, 2))
    model = calibration.color_model
    if isinstance(model, PolynomialModel) and len(model.coefficients) == count:
        return calibration
    return replace(calibration, color_model=PolynomialModel(coefficients, degrees, calibration.image_shape))


def stages(calibration: gelform.Calibration, image: np.ndarray) -> dict[str, Callable[[], Any]]:
    """Each stage of a frame on its own, and the whole."""
    reconstruct = gelform.Reconstructor(calibration)
    background = reconstruct.background
    rest = PreparedBackground(background, calibration.change)
    model = calibration.color_model.prepare(background, calibration.image_shape)
    exposure, _ = rest.compare(image)
    change = rest.change(image, exposure)
    gradients = model.gradients_from_color(change)[0]
    untouched = untouched_from_color_change(change, calibration.untouched_change)
    pitch = calibration.mm_per_px
    depth = gelform.depth_from_gradients(gradients, mm_per_px=pitch, zero=untouched)
    sigma = PreparedSigma(calibration.slope_sigma, calibration.image_shape, calibration.gamut)
    anchor = RestAnchor(calibration.image_shape, pitch, calibration.slope_sigma.clean)
    _, confidence = sigma(gradients, image, untouched, change)
    hold = anchor(gradients, untouched)
    return {
        "exposure, background check": lambda: rest.compare(image),
        "color change": lambda: rest.change(image, exposure),
        "color model (polynomial 4-3-1)": lambda: model.gradients_from_color(change),
        "untouched pixels": lambda: untouched_from_color_change(change, calibration.untouched_change),
        "sigma and confidence": lambda: sigma(gradients, image, untouched, change),
        "anchor at rest": lambda: anchor(gradients, untouched),
        "depth (dct), for comparison": lambda: gelform.integrate(gradients, mm_per_px=pitch, zero=untouched),
        "depth (weighted, anchored), residual": lambda: gelform.integrate(
            gradients, mm_per_px=pitch, weights=confidence, anchor=hold
        ),
        "contact": lambda: contact_from_depth(depth, mm_per_px=pitch),
        "whole frame": lambda: reconstruct.from_image(image),
    }


def main() -> None:
    """Time every size and print the table."""
    figures: dict[str, Any] = {}
    for shape in SIZES:
        calibration, image = calibration_at(shape)
        calls = stages(with_full_polynomial(calibration), image)
        pair, *times = median_ms([dct_pair(shape), *calls.values()], rounds=101, seconds=15)
        figures[f"{shape[0]}x{shape[1]}"] = {
            "D": pair,
            **{name: {"ms": ms, "D": ms / pair} for name, ms in zip(calls, times)},
        }
    names = list(next(iter(figures.values())))[1:]
    rows: list[list[Any]] = [["bare DCT pair D", *(f"{f['D']:.2f} ms" for f in figures.values())]]
    rows += [[n, *(f"{f[n]['D']:.1f} D ({f[n]['ms']:.2f} ms)" for f in figures.values())] for n in names]
    print(table(["stage", *figures], rows))
    write("speed", {"sizes": figures})


if __name__ == "__main__":
    main()
