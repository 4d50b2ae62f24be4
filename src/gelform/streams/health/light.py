"""Brighter, darker, another colour: the light where nothing touches against that of the start; and light from outside."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform.findings import Finding
from gelform.streams.evidence import Evidence

BRIGHTER = (
    0.08  # of all channels together, as a logarithm: calibrated slopes stay good, but something has changed
)
COLORED = 0.03  # of one channel against the others
OUTSIDE_LEVELS = 3.0  # grey levels that came in all channels alike
LEAST_PIXELS = 2_000
STEP_PX = 3
ROUNDS = 4


def light_findings(gains: NDArray[np.float64]) -> tuple[Finding, ...]:
    """`brightness_shift` and `color_shift` of gains (3,) against the start; a figure is the largest gain minus 1."""
    logs = np.log(np.maximum(gains, 1e-3))
    said = ", ".join(f"{name} {100 * (gain - 1):+.1f} %" for name, gain in zip("RGB", gains))
    findings = []
    if abs(float(logs.mean())) > BRIGHTER:
        message = f"The light has changed since the start ({said}): exposure, or the LEDs. It is compensated."
        findings.append(Finding("brightness_shift", message, float(np.exp(logs.mean()) - 1)))
    apart = logs - np.median(logs)
    worst = int(np.argmax(np.abs(apart)))
    if abs(float(apart[worst])) > COLORED:
        message = f"The light's colour has changed since the start ({said}): white balance, or an LED. It is compensated."
        findings.append(Finding("color_shift", message, float(np.exp(apart[worst]) - 1)))
    return tuple(findings)


def room_light_finding(evidence: Evidence) -> tuple[Finding, ...]:
    """`room_light`: light that was added to all channels, figure: grey levels.

    The sensor's own light multiplies the untouched image; light from outside is added to it, where it is dark too. Both are
    fitted to the untouched pixels, channel by channel, robustly: now = gain start + added.
    """
    lattice = np.s_[::STEP_PX, ::STEP_PX]
    free = ~evidence.contact[lattice]
    if np.count_nonzero(free) * STEP_PX**2 < LEAST_PIXELS:
        return ()
    now, start = evidence.image[lattice][free], evidence.start[lattice][free]
    added = np.array([_added(now[:, c], start[:, c]) for c in range(3)])
    least = float(added.min())
    if least < OUTSIDE_LEVELS:
        return ()
    message = (
        f"Light from outside: {least:.0f} grey levels were added in every channel. Slopes are read too flat by about "
        f"{100 * least / float(evidence.start.mean()):.0f} %. Shade the gel."
    )
    return (Finding("room_light", message, least),)


def _added(now: NDArray[np.float32], start: NDArray[np.float32]) -> float:
    """The constant of the robust line through (start, now), less three of its standard deviations; 0 where unknown."""
    x = start.astype(np.float64) - float(start.mean())
    weights = np.ones_like(x)
    for _ in range(ROUNDS):
        total = float(weights.sum())
        middle = float((weights * x).sum()) / total
        spread = float((weights * np.square(x - middle)).sum())
        if spread < 1e-6 * len(x):
            return 0.0
        level = float((weights * now).sum()) / total
        slope = float((weights * (x - middle) * (now - level)).sum()) / spread
        off = now - level - slope * (x - middle)
        noise = max(1.4826 * float(np.median(np.abs(off))), 1e-3)
        weights = np.square(np.clip(1 - np.square(off / (4 * noise)), 0, None))
    at_zero = -float(start.mean()) - middle
    independent = max(total / 50, 1.0)  # neighbours share what the line does not explain
    sigma = noise * np.sqrt(1 / independent + at_zero**2 / (spread / total * independent))
    return float(level + slope * at_zero - 3 * sigma)
