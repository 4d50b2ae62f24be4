"""What calibration tries: color models with their settings, the simplest first.

Which settings a color model should be tried with, how complex they are and whether `auto` tries them is said by the
model's own class (`variants` and `slow`); here nothing is listed again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.samples import (
    TOTAL_SAMPLES,
    PreparedPress,
    contact_samples,
    with_rest_samples,
)
from gelform.color_models import COLOR_MODELS, ColorModel, HierarchicalModel, Samples

AUTO = "auto"
ZONES = (0.7, 0.75, 0.8, 0.85, 0.9)
DEFAULT_ZONE = 0.8
ZONE_JUDGE_PRESSES = 18
START_RIDGES = (1e-1, 1e-2, 1e-3)


@dataclass(frozen=True, eq=False)
class Start:
    """The model of another unit of the same sensor, where a fit begins; two are equal only if they are the same one.

    Attributes
    ----------
    model : HierarchicalModel
    digest : of the calibration that it comes from
    zone : training zone of that calibration
    """

    model: HierarchicalModel
    digest: str
    zone: float


@dataclass(frozen=True)
class Candidate:
    """A color model with its settings, the zone that it trains on, and what it starts from.

    Attributes
    ----------
    model : a name in `COLOR_MODELS`
    zone : part of the contact radius inside which pixels train, 0-1
    settings : keywords of the model's `fit`, as pairs
    start : another unit's model, or None
    """

    model: str
    zone: float
    settings: tuple[tuple[str, Any], ...] = ()
    start: Start | None = None

    @property
    def change_offset(self) -> float:
        """Grey levels that are added to the background where its color changes are divided by it."""
        return float(COLOR_MODELS[self.model].change_offset)

    @property
    def reads_depth(self) -> bool:
        """Whether it asks for the depth of the pixels that it is fitted on."""
        return getattr(COLOR_MODELS[self.model], "depth_reader", None) is not None

    def fit(
        self,
        presses: Sequence[PreparedPress],
        contacts: Sequence[ContactCircle],
        *,
        total: int = TOTAL_SAMPLES,
    ) -> ColorModel:
        """The model, fitted on about `total` pixels of presses whose circles are known."""
        return self.fit_samples(self.samples(presses, contacts, total=total))

    def fit_samples(self, samples: Samples) -> ColorModel:
        """The model, fitted on samples."""
        start = {} if self.start is None else {"start": self.start.model}
        return COLOR_MODELS[self.model].fit(samples, **dict(self.settings), **start)

    def samples(
        self,
        presses: Sequence[PreparedPress],
        contacts: Sequence[ContactCircle],
        *,
        total: int = TOTAL_SAMPLES,
    ) -> Samples:
        """What it is fitted on: pixels inside the contacts' zones, and untouched ones; with depths for a model that asks."""
        samples = self._samples(presses, contacts, total)
        depth_reader = getattr(COLOR_MODELS[self.model], "depth_reader", None)
        if depth_reader is None:
            return samples
        read = depth_reader(samples, **dict(self.settings))
        measured = [replace(press, depth_px=read(press.color_change)) for press in presses]
        return self._samples(measured, contacts, total)

    def _samples(
        self, presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle], total: int
    ) -> Samples:
        return with_rest_samples(
            contact_samples(presses, contacts, self.zone, total=total), presses, contacts
        )

    def describe(self) -> str:
        """Name, settings and zone, short."""
        said = ["-".join(map(str, v)) if isinstance(v, tuple) else f"{k} {v:g}" for k, v in self.settings]
        return " ".join([self.model, *said]) + f", zone {self.zone:g}"


def color_model_names() -> list[str]:
    """What `calibrate` takes as its color model."""
    return [AUTO, *COLOR_MODELS]


def candidates_for(color_model: str, presses: int) -> list[Candidate]:
    """What is tried with so many training presses, the simplest first, at the default zone.

    Parameters
    ----------
    color_model : a name in `COLOR_MODELS`, for all its variants; or "auto", for the variants in `auto` of every
        model that is not slow
    presses : number of presses that train

    Raises
    ------
    ValueError
        The name is unknown.
    """
    if color_model not in color_model_names():
        raise ValueError(f"Expected color_model among {', '.join(color_model_names())}, got {color_model!r}.")
    if color_model != AUTO:
        offered = [(color_model, variant) for variant in COLOR_MODELS[color_model].variants(presses)]
    else:
        quick = {name: model for name, model in COLOR_MODELS.items() if not model.slow}
        offered = [(name, v) for name, model in quick.items() for v in model.variants(presses) if v.in_auto]
        offered.sort(key=lambda one: one[1].complexity)
    return [Candidate(name, DEFAULT_ZONE, tuple(variant.settings.items())) for name, variant in offered]


def candidates_from(start: Start) -> list[Candidate]:
    """What is tried on a second unit, stiffest first: the first unit's model, changed more and more freely."""
    return [Candidate("hierarchical", start.zone, (("ridge", ridge),), start) for ridge in START_RIDGES]


def zone_judge(presses: int) -> Candidate:
    """What judges the training zone: a polynomial, quick to fit and fine enough to see the rim."""
    return candidates_for("polynomial", min(presses, ZONE_JUDGE_PRESSES))[-1]
