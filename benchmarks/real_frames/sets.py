"""Sets of real presses, their calibrations, and calibrations carried to a unit without presses."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import gelform
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.starters import load_starter, starter_from_calibration
from presses import DATA, labeled, mini_ball, presses_of, unlabeled
from starters.make import LIKELY, unit_of

SETS = ("mini-ball", "digit-ball", "gelslim", "mini-d", "gelslim-dots", "gelsight-ball-deep")
MINIS = ("mini-edge", "mini-objects")  # units without presses of balls
MINI, MINI_MM_PER_PX = "gelsight-mini", 0.0634
EVERY = 6  # a quick run takes every sixth frame
ROOT = Path(gelform.__file__).parent
NATIVE = ROOT.parents[1] / "native"
# What a calibration follows from; a cached one is used again while none of these files changes.
SOURCES = (
    "calibration", "slopes/color_models", "slopes/budget.py", "slopes/sigma.py", "image/agreement.py", "image/background.py",
    "image/light.py", "image/registration.py", "calibration_file.py", "depth/coarse.py",
)  # fmt: skip
T = TypeVar("T")


@dataclass
class Run:
    """What was asked for, and the calibrations so far.

    Attributes
    ----------
    sets : names of sets of presses
    quick : whether every sixth frame is enough
    cache : folder where calibrations are kept for later runs
    """

    sets: Sequence[str] = SETS
    quick: bool = False
    cache: Path | None = None
    _made: dict[str, Any] = field(default_factory=dict)

    def some(self, items: Sequence[T]) -> Sequence[T]:
        """All of them, or every sixth."""
        return items[:: EVERY if self.quick else 1]

    def frames(self, count: int) -> int:
        """That many, or a sixth."""
        return len(self.some(range(count)))

    def kept(self, name: str, make: Callable[[], T]) -> T:
        """What `make` makes: once in a run, and once for all runs with a cache while the sources stay the same."""
        if name not in self._made:
            path = None if self.cache is None else self.cache / f"{_sources_digest()} {name}.pickle"
            if path is not None and path.is_file():
                self._made[name] = pickle.loads(path.read_bytes())
            else:
                self._made[name] = make()
                if path is not None:
                    path.parent.mkdir(parents=True, exist_ok=True)
                    path.write_bytes(pickle.dumps(self._made[name]))
        found: T = self._made[name]
        return found

    def presses(self, name: str) -> Presses:
        """The presses of a set; those of mini-ball have the circles for scoring."""
        return mini_ball()[0] if name == "mini-ball" else gelform.read_presses(DATA / name)

    def calibration(self, name: str) -> gelform.Calibration:
        """A set's own calibration, made of all its presses without labels."""
        return self.kept(name, lambda: gelform.calibrate(unlabeled(self.presses(name))))

    def layout(self, name: str) -> gelform.Calibration:
        """The calibration of a simulated layout, from 24 presses."""

        def made() -> gelform.Calibration:
            rng, sensor = np.random.default_rng(11), gelform.simulate.LAYOUTS[name]
            simulated = gelform.simulate.simulate_ball_presses(
                sensor, ball_diameters_mm=[5.0, 8.0], count=24, rng=rng, oversample=1
            )
            return gelform.calibrate(presses_of(simulated), color_model="hierarchical")

        return self.kept(name, made)

    def circles(self, name: str) -> list[tuple[float, float, float] | None]:
        """Center and radius, px, of each press's visible circle: the reference's or the calibration's; None if unsure."""
        if name == "mini-ball":
            return [press.label for press in self.presses(name).presses]
        rows = self.calibration(name).report.presses
        return [
            (row.center_x_px, row.center_y_px, row.contact_radius_px) if row.accepted else None
            for row in rows
        ]

    def unit(self, name: str) -> Any:
        """The presses of a set in the order of their names, with the likely diameter of mini-d's ball."""
        if name == "mini-ball":
            presses, order = mini_ball()
            return presses.subset(order)
        presses, factor = self.presses(name), LIKELY if name == "mini-d" else 1.0
        balls = (replace(one, ball_diameter_mm=one.ball_diameter_mm * factor) for one in presses.presses)
        return replace(presses, presses=tuple(balls))

    def labeled(self, name: str) -> Any:
        """The same with circles for scoring: the reference's, or those of a calibration on all; only presses with one."""
        return self.kept(f"{name}, labeled", lambda: labeled(self.unit(name)))

    def carried(
        self, name: str, background: np.ndarray, mm_per_px: float = MINI_MM_PER_PX
    ) -> gelform.Calibration:
        """The Mini starter, or a starter made of one Mini's presses alone, for another Mini's background image."""
        shipped = load_starter(MINI)
        if name == "starter":
            return shipped.for_unit(background, mm_per_px=mm_per_px)
        own = self.kept(f"{name}, alone", lambda: gelform.calibrate(unlabeled(self.unit(name)), start=None))
        stated = {"spread": shipped.spread, "color_variance": shipped.color_variance}
        starter = starter_from_calibration(own, MINI, units=(name,), **stated)
        return unit_of(starter, background, mm_per_px)


def _sources_digest() -> str:
    """Digest of the sources that calibrations follow from, kernels included."""
    folders = [ROOT / name for name in SOURCES] + [NATIVE / name.removesuffix(".py") for name in SOURCES]
    paths = [path for folder in folders for path in folder.rglob("*.[pch]*")]
    paths += [path for path in folders if path.is_file()]
    digest = hashlib.sha256()
    for path in sorted(paths):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def background_of(name: str) -> np.ndarray:
    """The background image of a unit without presses."""
    return gelform.read_image(DATA / name / "background.png")


def percent(of: Sequence[Any] | np.ndarray) -> float:
    """Share of what is true, percent."""
    return float(100 * np.mean(of)) if len(of) else float("nan")
