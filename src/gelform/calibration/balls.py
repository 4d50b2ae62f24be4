"""Check of the stated ball diameter against the diameter that colors of other units or presses give.

A calibration believes its labels: with every diameter doubled it reads every slope half as steep, and its own held-out
presses with small errors. Other units of the make, or presses of another size, do not share that mistake. An image shows
only the ratio of diameter to pixel pitch, so either may be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.candidates import Start, training_samples
from gelform.calibration.circles.find import ContactCircle, why_no_contact
from gelform.calibration.circles.locate import Located
from gelform.calibration.circles.samples import PRESS_PIXELS, TRIAL_SAMPLES, PreparedPress
from gelform.calibration.enough import NEEDED
from gelform.result.metrics.ball import radius_from_gradients
from gelform.slopes.color_models import COLOR_MODELS, DEFAULT_MODEL, ColorModel

INNER = 0.6  # fraction of the visible circle; the gel follows the ball inside it on every sensor
# Relative error of the ratio of two sizes, each read by the other's presses: 0.034 on a real GelSight Mini.
SIZE_SIGMA = 0.05
# Largest difference of a stated diameter from the one read, in standard deviations: the only limit, also of the report's
# check. And what to do beyond it.
MOST_SIGMAS = 2.0
REMEDY = "Check the ball's diameter and mm_per_px."


@dataclass(frozen=True)
class BallReading:
    """A ball's stated diameter, the diameter that was read, and the model that read it."""

    stated_mm: float
    read_mm: float
    sigma_mm: float
    by: str

    def to_dict(self) -> dict[str, float | str]:
        """Its fields and `sigmas`."""
        return {**asdict(self), "sigmas": self.sigmas}

    @property
    def sigmas(self) -> float:
        """Standard deviations between the two diameters; of their logarithm, so that twice and half are alike.

        Of three digits, as printed, so that every judgment is of the same number.
        """
        return float(f"{abs(np.log(self.read_mm / self.stated_mm)) / (self.sigma_mm / self.read_mm):.3g}")

    def sentence(self) -> str:
        """The comparison in words."""
        read = f"{self.read_mm:.3g} ± {self.sigma_mm:.2g} mm"
        if self.sigmas > MOST_SIGMAS:
            return (
                f"The presses look like a ball of {read}, but the stated diameter is {self.stated_mm:g} mm. {REMEDY} "
                f"The measurement uses {self.by}."
            )
        return f"The stated diameter of {self.stated_mm:g} mm agrees with {read}, as measured by {self.by}."


UNCHECKED = (
    "Nothing checked the ball's diameter. gelform knows no other unit of this sensor, and the presses are of one "
    "size, or too few are of a second one. If the diameter or mm_per_px is wrong, every depth is wrong in "
    "proportion. Measure the ball."
)


def ball_readings(located: Located, known: Start | None) -> tuple[BallReading, ...]:
    """Each stated diameter with the one that another unit's model reads, or else the presses of the other sizes."""
    if known is not None:
        return _by_model(located, known)
    return _by_sizes(located)


def notes_of(readings: Sequence[BallReading]) -> tuple[str, ...]:
    """Notes on the ball's diameter: an error, else an agreement, else that nothing checked it."""
    wrong = [one.sentence() for one in readings if one.sigmas > MOST_SIGMAS]
    return tuple(wrong or [one.sentence() for one in readings] or [UNCHECKED])


def _by_model(located: Located, known: Start) -> tuple[BallReading, ...]:
    chosen = located.refined.accepted or [
        i for i, contact in enumerate(located.found) if why_no_contact(contact) is None
    ]
    readings = []
    for stated, members in _by_size(located, chosen).items():
        logs = _log_ratios(located, members, known.model)
        if logs.size:
            of_median = (
                1.2533 * float(logs.std()) / np.sqrt(logs.size)
            )  # standard error of the median of normal errors
            read = stated * float(np.exp(np.median(logs)))
            readings.append(
                BallReading(stated, read, read * float(np.hypot(known.spread, of_median)), known.by)
            )
    return tuple(readings)


def _by_sizes(located: Located) -> tuple[BallReading, ...]:
    """The second size, and further ones, read by the first one's presses, and vice versa: the mean of both."""
    sizes = {
        stated: members
        for stated, members in _by_size(located, located.refined.accepted).items()
        if NEEDED.size.met(len(members))
    }
    readings = []
    for stated in list(sizes)[1:]:
        (first, own), other = next(iter(sizes.items())), sizes[stated]
        forth, back = (
            float(np.median(_log_ratios(located, read, _fitted_on(located, training))))
            for training, read in ((own, other), (other, own))
        )
        read = stated * float(np.exp((forth - back) / 2))
        readings.append(BallReading(stated, read, SIZE_SIGMA * read, f"the presses of {first:g} mm"))
    return tuple(readings)


def _by_size(located: Located, chosen: Sequence[int]) -> dict[float, list[int]]:
    """The presses of each diameter, mm, the one with the most presses first."""
    sizes: dict[float, list[int]] = {}
    for i in chosen:
        sizes.setdefault(located.presses.presses[i].ball_diameter_mm, []).append(i)
    return dict(sorted(sizes.items(), key=lambda pair: -len(pair[1])))


def _fitted_on(located: Located, members: Sequence[int]) -> ColorModel:
    presses, contacts = [located.prepared[i] for i in members], [located.refined.contacts[i] for i in members]
    return COLOR_MODELS[DEFAULT_MODEL].fit(training_samples(presses, contacts, total=TRIAL_SAMPLES))


def _log_ratios(located: Located, members: Sequence[int], model: ColorModel) -> NDArray[np.float64]:
    """Logarithms of the radius that a model reads over the stated one, of the presses that show a ball."""
    ratios = [_ratio(located.prepared[i], located.refined.contacts[i], model) for i in members]
    return np.log([ratio for ratio in ratios if 0 < ratio < np.inf])


def _ratio(press: PreparedPress, contact: ContactCircle, model: ColorModel) -> float:
    inner = replace(press, contact_radius_ratio=INNER)
    rows, cols = inner.pixels(contact, 1.0, PRESS_PIXELS)
    if len(rows) < 30:
        return float("nan")
    return radius_from_gradients(press.gradients(model, rows, cols), cols, rows) / press.ball_radius_px
