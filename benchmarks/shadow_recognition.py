"""Part of confidence.py: whether presses are recognised as casting shadows, of few presses and of many.

The rule was chosen on every second press of mini-ball and digit-ball from the first, on the layouts, and on DIGITs of the
seeds 401 to 404 with and without shadows. Figures are of the other presses, of other DIGITs, and of other drawn sensors.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import gelform
from accuracy_punches import drawn_sensor
from cast_shadows import BALLS_MM, drawn_digit
from gelform.calibration.circles.followed import followed_share
from gelform.calibration.circles.prepare import find_contacts, prepare
from gelform.calibration.circles.refine import refine
from gelform.calibration.forward import forward_from_presses
from gelform.calibration.selection.candidates import DEFAULT_ZONE, Candidate
from gelform.calibration.shadows import shadow_noise
from gelform.simulate import SimulatedSensor, simulate_ball_presses

SIZES = 18, 15, 12  # presses
DRAWS = 10  # of real presses
DIGITS = tuple(range(411, 421))
DRAWN = tuple(range(421, 427))


def recognised(data: Path, quick: bool) -> dict[str, Any]:
    """Subsets of presses that are said to cast shadows, and of how many, by their number; and whether they do cast some."""
    found: dict[str, Any] = {}
    for name, casts, subsets in _sets(data, quick):
        row = found.setdefault(name, {"casts": casts, **{str(size): [0, 0] for size in SIZES}})
        for presses in subsets:
            counts = row[str(len(presses.presses))]
            counts[0] += casts_shadows(presses)
            counts[1] += 1
    return found


def casts_shadows(presses: Any) -> bool:
    """As `calibrate` finds it, by a hierarchical model of the usual zone, which is not chosen among others."""
    prepared = prepare(presses)
    refined = refine(prepared, find_contacts(prepared))
    used, contacts = ([of[i] for i in refined.accepted] for of in (prepared, refined.contacts))
    share = followed_share(used, contacts)
    if share < 1:
        prepared = [replace(press, followed=share) for press in prepared]
        refined = refine(prepared, find_contacts(prepared))
        used, contacts = ([of[i] for i in refined.accepted] for of in (prepared, refined.contacts))
    model = Candidate("hierarchical", DEFAULT_ZONE).fit(used, contacts)
    forward = forward_from_presses(used, contacts, DEFAULT_ZONE, presses.mm_per_px, presses.sensor_name)
    return shadow_noise(model, forward, used, contacts, presses.background) is not None


def _sets(data: Path, quick: bool) -> Iterator[tuple[str, bool, Iterator[Any]]]:
    for name, casts in (("mini-ball", False), ("digit-ball", True)):
        if (data / name).is_dir():
            presses = gelform.read_presses(data / name)
            others = presses.subset(range(1, len(presses.presses), 2))
            yield name, casts, _drawn(others, 2 if quick else DRAWS)
    for seed in DIGITS[:1] if quick else DIGITS:
        sensor = drawn_digit(seed)
        yield "digits", True, _drawn(_simulated(sensor, seed, BALLS_MM), 1)
        without = replace(sensor, cast_shadows=False)
        yield "digits without shadows", False, _drawn(_simulated(without, seed, BALLS_MM), 1)
    for seed in DRAWN[:1] if quick else DRAWN:
        yield "drawn sensors", False, _drawn(_simulated(drawn_sensor(seed), seed, (5.0, 8.0)), 1)


def _drawn(presses: Any, draws: int) -> Iterator[Any]:
    for size in SIZES:
        for draw in range(draws):
            rng = np.random.default_rng([1, size, draw])
            chosen = rng.choice(len(presses.presses), size, replace=False)
            yield presses.subset(sorted(chosen.tolist()))


def _simulated(sensor: SimulatedSensor, seed: int, balls_mm: tuple[float, float]) -> Any:
    rng = np.random.default_rng(seed)
    made = simulate_ball_presses(
        sensor, ball_diameters_mm=balls_mm, count=max(SIZES) + 2, rng=rng, oversample=1
    )
    with tempfile.TemporaryDirectory() as folder:
        gelform.save_simulated_presses(Path(folder) / "presses", made)
        return gelform.read_presses(Path(folder) / "presses")
