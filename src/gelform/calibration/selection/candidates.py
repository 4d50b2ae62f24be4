"""What calibration tries: color models with their settings, simplest first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from gelform.calibration.circles.find import Contact
from gelform.calibration.circles.samples import (
    TOTAL_SAMPLES,
    PreparedPress,
    contact_samples,
    with_rest_samples,
)
from gelform.color_models import COLOR_MODELS, ColorModel, HierarchicalModel, Samples

ZONES = (0.7, 0.75, 0.8, 0.85, 0.9)
DEFAULT_ZONE = 0.8
DEGREES = (((1,), 3), ((2, 1), 6), ((3, 2, 0), 9), ((4, 3, 1), 18), ((5, 4, 3), 30))
ENOUGH = 18  # presses
MANY = 30
RIDGES = (3e-4, 1e-4)
FEW_RIDGES = (1e-3, 3e-4)
START_RIDGES = (1e-1, 1e-2, 1e-3)


@dataclass(frozen=True, eq=False)
class Start:
    """What another unit of the same sensor taught: where the fit begins; equal to itself alone."""

    model: HierarchicalModel
    digest: str


@dataclass(frozen=True)
class Candidate:
    """A color model with its settings, the zone of the contact radius that it trains on, and what it starts from."""

    model: str
    zone: float
    settings: tuple[tuple[str, Any], ...] = ()
    start: Start | None = None

    @property
    def change_offset(self) -> float:
        """What its color changes are divided by beside the background."""
        return float(COLOR_MODELS[self.model].change_offset)

    def fit(
        self,
        presses: Sequence[PreparedPress],
        contacts: Sequence[Contact],
        *,
        total: int = TOTAL_SAMPLES,
    ) -> ColorModel:
        """The model, fitted on presses with known circles."""
        return self.fit_samples(self.samples(presses, contacts, total=total))

    def fit_samples(self, samples: Samples) -> ColorModel:
        """The model, fitted on samples."""
        start = {} if self.start is None else {"start": self.start.model}
        model: ColorModel = COLOR_MODELS[self.model].fit(samples, **dict(self.settings), **start)
        return model

    def samples(
        self,
        presses: Sequence[PreparedPress],
        contacts: Sequence[Contact],
        *,
        total: int = TOTAL_SAMPLES,
    ) -> Samples:
        """What it is fitted on: the contacts' zones and gel at rest."""
        return with_rest_samples(
            contact_samples(presses, contacts, self.zone, total=total), presses, contacts
        )

    def describe(self) -> str:
        """Name, settings and zone, short."""
        said = ["-".join(map(str, v)) if isinstance(v, tuple) else f"{k} {v:g}" for k, v in self.settings]
        return " ".join([self.model, *said]) + f", zone {self.zone:g}"


def candidates_for(color_model: str, presses: int) -> list[Candidate]:
    """What is tried, simplest first, at the default zone.

    "auto" leaves the polynomials between the plainest and the largest to `hierarchical`, which is stiff where they
    have few terms; models that no sensor has chosen yet are tried where there are presses enough to tell. `mlp`
    is tried only by name: it needs torch, and a result must not depend on what else is installed.
    """
    polynomials = [
        Candidate("polynomial", DEFAULT_ZONE, (("position_degrees", degrees),))
        for degrees, needed in DEGREES
        if presses >= needed
    ]
    ridges = RIDGES if presses >= ENOUGH else FEW_RIDGES
    known: dict[str, list[Candidate]] = {
        "lambertian": [Candidate("lambertian", DEFAULT_ZONE)],
        "near_light": [Candidate("near_light", DEFAULT_ZONE)],
        "polynomial": polynomials,
        "hierarchical": [Candidate("hierarchical", DEFAULT_ZONE, (("ridge", r),)) for r in ridges],
        "interpolation": [Candidate("interpolation", DEFAULT_ZONE)],
        "lookup": [Candidate("lookup", DEFAULT_ZONE)],
        "mlp": [Candidate("mlp", DEFAULT_ZONE)],
    }
    if color_model == "auto":
        others = known["near_light"] if presses >= MANY else []
        dear = known["lookup"] + known["interpolation"] if presses >= MANY else []
        largest = polynomials[-1:] if presses >= ENOUGH else []
        return known["lambertian"] + others + polynomials[:1] + known["hierarchical"] + largest + dear
    if color_model not in known:
        raise ValueError(f"Expected color_model among auto, {', '.join(known)}, got {color_model!r}.")
    return known[color_model]


def candidates_from(start: Start, zone: float) -> list[Candidate]:
    """What is tried on a second unit, stiffest first: the first unit's model, changed more and more freely."""
    return [Candidate("hierarchical", zone, (("ridge", ridge),), start) for ridge in START_RIDGES]


def zone_judge(presses: int) -> Candidate:
    """What the training zone is judged by: quick to fit, and fine enough to see the rim."""
    return candidates_for("polynomial", min(presses, ENOUGH))[-1]
