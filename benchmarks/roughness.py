"""Areal roughness beside that of surfalize, an independent package, on surfaces made here; pip install surfalize first.

    python benchmarks/roughness.py               # into results/roughness.json: a few seconds

It is GPL-3.0: nothing of gelform imports it, and this script runs it only where it is installed.
"""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray
from surfalize import Surface

from gelform.metrics import FORMS, areal_roughness
from report import table, write

PITCH_MM, SIZE, CORRELATION_PX, SIGMA_MM = 0.02, 512, 12.0, 0.02
NAMES = {"Sa": "Sa_um", "Sq": "Sq_um", "Sz": "Sz_um", "Ssk": "Ssk", "Sku": "Sku", "Sdr": "Sdr_percent"}


def surfaces() -> dict[str, NDArray[Any]]:
    """Heights in mm: Gaussian, skewed, periodic, and Gaussian on a ball of 20 mm."""
    rng, frequency = np.random.default_rng(0), np.fft.fftfreq(SIZE)
    square = frequency[:, None] ** 2 + frequency**2
    smooth = np.exp(-((2 * np.pi * CORRELATION_PX) ** 2) * square / 8)
    field = np.fft.ifft2(np.fft.fft2(rng.normal(size=(SIZE, SIZE))) * smooth).real
    field *= SIGMA_MM / field.std()
    y, x = np.mgrid[:SIZE, :SIZE] * PITCH_MM
    return {
        "Gaussian field": field,
        "skewed field": SIGMA_MM * np.exp(field / SIGMA_MM),
        "crossed waves": 0.01 * np.sin(2 * np.pi * x) + 0.02 * np.sin(2 * np.pi * y / 1.3),
        "Gaussian field on a ball": field + np.sqrt(20**2 - (x - 5.1) ** 2 - (y - 5.1) ** 2),
    }


def theirs(heights: NDArray[Any], degree: int) -> dict[str, float]:
    """Figures of surfalize, which wants um, with a polynomial removed; not filtered."""
    surface = Surface(1e3 * heights, 1e3 * PITCH_MM, 1e3 * PITCH_MM)
    surface = surface.detrend_polynomial(degree) if degree else surface
    return {name: float(getattr(surface, name)()) for name in NAMES}


def main() -> None:
    """Compare, print and write."""
    rows = []
    for name, heights in surfaces().items():
        for form, degree in FORMS.items():
            how: dict[str, Any] = {"form": form, "s_filter_mm": None, "l_filter_mm": None}
            ours = areal_roughness(heights, mm_per_px=PITCH_MM, **how)
            other = theirs(heights, degree)
            pairs = {one: (getattr(ours, NAMES[one]), other[one]) for one in NAMES}
            apart = {one: abs(a - b) / max(abs(b), 1e-3) for one, (a, b) in pairs.items()}
            rows.append({"surface": name, "form": form, "ours_theirs": pairs, "relative_difference": apart})
    most = {one: max(row["relative_difference"][one] for row in rows) for one in NAMES}
    print(table(("", "largest relative difference"), [(one, f"{value:.2g}") for one, value in most.items()]))
    write("roughness", {"surfalize": version("surfalize"), "largest_relative_difference": most, "rows": rows})


if __name__ == "__main__":
    main()
