"""Faults of a whole set of presses, which no single image shows; and of the stated ball diameter.

The diameter is checked against the one that colors of other units or presses give. A calibration believes its labels: with
every diameter doubled it reads every slope half as steep, and its own held-out presses with small errors. Other units of the
make, or presses of another size, do not share that mistake. An image shows only the ratio of diameter to pixel pitch, so
either may be wrong.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from gelform.arrays import Array, Map, Numbers
from gelform.calibration.circles.find import (
    LEAST_PIXELS,
    PRESS_PIXELS,
    RIM,
    TRIAL_SAMPLES,
    ContactCircle,
    PreparedPress,
    contact_samples,
    parabola_offset,
    ring_mean,
    scale_of,
    training_samples,
    why_no_contact,
)
from gelform.calibration.circles.locate import Located, fit_model, light_notes
from gelform.calibration.coverage import FOLDS, NEEDED, SAMPLED, coverage_notes
from gelform.calibration.presses.press_set import NAMED, Presses
from gelform.calibration.start import USUAL_SPREAD, Start
from gelform.calibration_file import Calibration
from gelform.errors import CalibrationError, Finding
from gelform.foundations.filters import SIGMA_OF_MEDIAN
from gelform.image.agreement import check_background_of_frames, orientation_if_doubtful, touch_in_first
from gelform.image.background import surround_finding
from gelform.result.metrics import score_slopes
from gelform.sensors.profiles import (
    PROFILES,
    SAME_SCALE,
    check_gel_width,
    light_order_of,
    make_of,
    scale_off_make,
)
from gelform.slopes.color_models import COLOR_MODELS, DEFAULT_MODEL, ColorModel
from gelform.slopes.color_models.seam import HUBER_SLOPE

INNER = 0.6  # fraction of the visible circle; the gel follows the ball inside it on every sensor
# Relative error of the ratio of two sizes, each read by the other's presses: 0.034 on a real GelSight Mini.
SIZE_SIGMA = 0.05
# Largest difference of a stated diameter from the one read, in standard deviations; the limit of the report's check too.
MOST_SIGMAS = 2.0
REMEDY = "Check the ball's diameter and mm_per_px."


@dataclass(frozen=True)
class BallReading:
    """A ball's stated diameter, and the one that was read."""

    stated_mm: float
    read_mm: float
    sigma_mm: float
    by: str  # the model that read it
    own: bool = False  # made from these presses: that it agrees is no check
    presses: tuple[
        str, ...
    ] = ()  # the names of those that it is of, where they are a part of one stated ball's

    def to_dict(self) -> dict[str, Any]:
        """Its fields, `sigmas`, `checks` and `remedy`."""
        return {**asdict(self), "sigmas": self.sigmas, "checks": self.checks, "remedy": self.remedy}

    @property
    def remedy(self) -> str:
        """What to check where the diameters differ."""
        if not self.presses:
            return f"{REMEDY} Presses of another unit or of another ball contradict them."
        return (
            f"Write the diameter of each press's own ball into presses.csv: {len(self.presses)} of them "
            f"({', '.join(self.presses[:NAMED])}{' ...' if len(self.presses) > NAMED else ''}) look like a ball "
            f"{self.read_mm / self.stated_mm:.2g} times as large as that of the others."
        )

    @property
    def sigmas(self) -> float:
        """Standard deviations between the two diameters; of their logarithm, so that twice and half are alike.

        Of three digits, as printed, so that every judgment is of the same number.
        """
        return float(f"{abs(np.log(self.read_mm / self.stated_mm)) / (self.sigma_mm / self.read_mm):.3g}")

    def sentence(self) -> str:
        """The comparison in words."""
        read = f"{self.read_mm:.3g} ± {self.sigma_mm:.2g} mm"
        if self.presses:
            return f"Two balls seem to be under one diameter. {self.remedy}"
        if self.sigmas > MOST_SIGMAS:
            return (
                f"The presses look like a ball of {read}, but the stated diameter is {self.stated_mm:g} mm. {REMEDY} "
                f"The measurement uses {self.by}."
            )
        if self.own:
            return f"Nothing checked the ball's diameter: {self.by} was made from these presses."
        return f"The stated diameter of {self.stated_mm:g} mm agrees with {read}, as measured by {self.by}."

    @property
    def checks(self) -> bool:
        """Whether it says something about the stated diameter."""
        return not self.own or self.sigmas > MOST_SIGMAS


UNCHECKED = (
    "Nothing checked the ball's diameter. gelform knows no other unit of this sensor, and the presses are of one "
    "size, or too few are of a second one. If the diameter or mm_per_px is wrong, every depth is wrong in "
    "proportion. Measure the ball."
)


def ball_readings(located: Located, known: Start | None) -> tuple[BallReading, ...]:
    """Each stated diameter with the one that another unit's model reads, or else the presses of the other sizes."""
    return _by_sizes(located) if known is None else _by_model(located, known)


def notes_of(readings: Sequence[BallReading]) -> tuple[str, ...]:
    """Notes on the ball's diameter: an error, else an agreement, else that nothing checked it."""
    wrong = [one.sentence() for one in readings if one.sigmas > MOST_SIGMAS]
    return tuple(wrong or dict.fromkeys(one.sentence() for one in readings) or [UNCHECKED])


def light_press_notes(located: Located, readings: Sequence[BallReading]) -> tuple[str, ...]:
    """A note where nothing checked the ball, and nine of ten contacts are small on it."""
    prepared, contacts = located.refined.of_accepted(located.prepared)
    shares = [contact.radius_px / press.ball_radius_px for press, contact in zip(prepared, contacts)]
    if any(one.checks for one in readings) or not shares or np.quantile(shares, 0.9) > INNER:
        return ()
    presses = located.presses
    return (
        f"The contacts have {min(shares):.2f} to {max(shares):.2f} of the ball's radius, and the gel would be "
        f"{presses.mm_per_px * max(presses.image_shape):.3g} mm wide. Either the presses are light, or the stated diameter "
        f"is too large or mm_per_px too small, and every depth is too small. {REMEDY}",
    )


def _by_model(located: Located, known: Start) -> tuple[BallReading, ...]:
    chosen = located.refined.accepted or [
        i for i, press in enumerate(located.prepared) if why_no_contact(press.found) is None
    ]
    readings = []
    for stated, members in _by_size(located, chosen).items():
        logs = _log_ratios(located, members, known.model)
        if logs.size:
            # standard error of the median of normal errors
            of_median = sqrt(pi / 2) * float(logs.std()) / np.sqrt(logs.size)
            read = stated * float(np.exp(np.median(logs)))
            sigma = read * float(np.hypot(known.spread, of_median))
            readings.append(BallReading(stated, read, sigma, known.by, known.own))
    return tuple(readings)


def readings_of_errors(
    calibration: Calibration, radii: Mapping[float, Sequence[float]]
) -> tuple[BallReading, ...]:
    """Each stated diameter with the one that a calibration reads: `radii` has spheres' errors of its presses, %.

    The calibration's own error of the radius is their standard deviation, or the make's spread.
    """
    usual = SIGMA_OF_MEDIAN * calibration.held_out.get("radius_percent", 0.0) / 100
    spread = max(usual, calibration.unit_spread or 0.0) or USUAL_SPREAD
    readings = []
    for stated, errors in radii.items():
        logs = np.log([1 + one / 100 for one in errors if np.isfinite(one) and one > -100])
        if logs.size:
            read = stated * float(np.exp(np.median(logs)))
            sigma = read * float(np.hypot(spread, sqrt(pi / 2) * float(logs.std()) / np.sqrt(logs.size)))
            readings.append(BallReading(stated, read, sigma, "this calibration"))
    return tuple(readings)


def mixed_balls(located: Located, radius_errors: Sequence[float]) -> tuple[BallReading, ...]:
    """The ball of the presses that read as another than the other ones under its diameter; () if all read alike.

    Presses are split between two balls, by the width of the contact at first; each goes to the ball by which a model of both
    explains its slopes better. Two are likelier than one if held-out presses, each an observation of unknown variance, gain
    more than the two parameters cost (G. Schwarz, Ann. Statist. 6, 1978). It is not asked while held-out spheres are right,
    by their `radius_errors` (%).
    """
    if np.nanmedian(np.abs(radius_errors)) <= 100 * SIZE_SIGMA:
        return ()
    refined, chosen = located.refined, np.array(located.refined.accepted)
    wide = np.array([refined.contacts[i].radius_px / located.prepared[i].ball_radius_px for i in chosen])
    split, ratio, tried = wide > np.median(wide), 1.0, set[bytes]()
    while split.tobytes() not in tried:
        if min(np.count_nonzero(part) for part in (split, ~split)) < NEEDED.model.presses:
            return ()
        tried.add(split.tobytes())
        ratio = _size_ratio(located, chosen[~split], chosen[split])
        one, other = _misfits(located, chosen, chosen, np.where(split, ratio, 1.0), (1.0, ratio))
        split = other < one
    single, both, gains = np.ones(len(chosen)), np.where(split, ratio, 1.0), 0.0
    for fold in range(FOLDS):
        held_out = np.arange(len(chosen)) % FOLDS == fold
        errors = [
            _misfits(located, chosen[~held_out], chosen[held_out], of[~held_out], (of[held_out],))[0]
            for of in (single, both)
        ]
        gains += float(np.sum(np.log(errors[0] / errors[1])))
    if not gains > np.log(len(chosen)):
        return ()
    # The larger part is taken as stated.
    if 2 * np.count_nonzero(split) > len(chosen):
        split, ratio = ~split, 1 / ratio
    members = [located.presses.presses[i] for i in chosen[split]]
    stated = float(np.median([press.ball_diameter_mm for press in members]))
    by = f"the other {len(chosen) - len(members)} presses"
    names = tuple(press.name for press in members)
    found = BallReading(stated, stated * ratio, SIZE_SIGMA * stated * ratio, by, presses=names)
    return (found,) if found.sigmas > MOST_SIGMAS else ()


def _misfits(
    located: Located,
    training: Sequence[int] | Array,
    members: Sequence[int] | Array,
    balls: Numbers,
    tried: Sequence[float | Numbers],
) -> list[Numbers]:
    """Relative slope errors (RMS) of each member, one array for each tried ball, by a model of the training presses' balls.

    Balls are factors of the stated ones, of all or of each press.
    """

    def scaled(i: int, factor: float) -> PreparedPress:
        press = located.prepared[i]
        return replace(press, ball_radius_px=factor * press.ball_radius_px, contact_radius_ratio=INNER)

    contacts = located.refined.contacts
    model = fit_model([scaled(*one) for one in zip(training, balls)], [contacts[i] for i in training])
    errors = np.full((len(tried), len(members)), np.nan)
    for k, factors in enumerate(tried):
        for n, factor in enumerate(np.broadcast_to(factors, len(members))):
            press, contact = scaled(members[n], factor), contacts[members[n]]
            rows, cols = press.pixels(contact, 1.0, PRESS_PIXELS)
            if len(rows) >= LEAST_PIXELS:
                score = score_slopes(
                    press.gradients(model, rows, cols),
                    cols,
                    rows,
                    contact.circle_px[:2],
                    press.ball_radius_px,
                )
                errors[k, n] = np.linalg.norm(score.errors) / np.linalg.norm(score.true_gradients)
    return list(errors)


def _size_ratio(located: Located, first: Sequence[int], second: Sequence[int]) -> float:
    """Factor of the second presses' ball over its stated one, relative to the first ones': each is read by the other."""
    logs = []
    for training, members in ((first, second), (second, first)):
        presses = [located.prepared[i] for i in training]
        contacts = [located.refined.contacts[i] for i in training]
        model = COLOR_MODELS[DEFAULT_MODEL].fit(training_samples(presses, contacts, total=TRIAL_SAMPLES))
        logs.append(float(np.median(_log_ratios(located, members, model))))
    return float(np.exp((logs[0] - logs[1]) / 2))


def _by_sizes(located: Located) -> tuple[BallReading, ...]:
    """The second size, and further ones, read by the first one's presses, and vice versa: the mean of both."""
    sizes = _by_size(located, located.refined.accepted).items()
    enough = [(stated, members) for stated, members in sizes if NEEDED.size.met(len(members))]
    readings = []
    for stated, other in enough[1:]:
        first, own = enough[0]
        read = stated * _size_ratio(located, own, other)
        readings.append(BallReading(stated, read, SIZE_SIGMA * read, f"the presses of {first:g} mm"))
    return tuple(readings)


def _by_size(located: Located, chosen: Sequence[int]) -> dict[float, list[int]]:
    """The presses of each diameter, mm, the one with the most presses first."""
    sizes: dict[float, list[int]] = {}
    for i in chosen:
        sizes.setdefault(located.presses.presses[i].ball_diameter_mm, []).append(i)
    return dict(sorted(sizes.items(), key=lambda pair: -len(pair[1])))


def _log_ratios(located: Located, members: Sequence[int], model: ColorModel) -> NDArray[np.float64]:
    """Logarithms of the radius that a model reads over the stated one, of the presses that show a ball."""
    ratios = []
    for i in members:
        press = located.prepared[i]
        inner = replace(press, contact_radius_ratio=INNER)
        rows, cols = inner.pixels(located.refined.contacts[i], 1.0, PRESS_PIXELS)
        if len(rows) >= LEAST_PIXELS:
            radius = radius_from_gradients(press.gradients(model, rows, cols), cols, rows)
            ratios.append(radius / press.ball_radius_px)
    return np.log([ratio for ratio in ratios if 0 < ratio < np.inf])


def radius_from_gradients(gradients: Array, x_px: Array, y_px: Array) -> float:
    """Radius, px, of the ball with the slopes closest to gradients (N, 2) at pixel positions (N,); the center is free.

    The first two components of a ball's normals are `((x - cx)/R, (y - cy)/R)`. So 1/R is the slope of a line through them,
    fitted by least squares with Huber weights. The radius is infinite or negative if the slopes show no ball.
    """
    slopes = np.asarray(gradients, dtype=np.float64)
    normals = -slopes / np.sqrt(1 + np.sum(slopes**2, axis=1, keepdims=True))
    place = np.stack([x_px, y_px], axis=1).astype(np.float64)
    weight = np.ones(len(place))
    for _ in range(8):  # later rounds move the radius by less than 0.1 %
        away, turned = (v - np.average(v, axis=0, weights=weight) for v in (place, normals))
        curvature = np.sum(weight[:, None] * away * turned) / np.sum(weight[:, None] * away**2)
        error = np.linalg.norm(turned - curvature * away, axis=1)
        weight = np.minimum(1, HUBER_SLOPE / np.maximum(error, 1e-12))  # about the usual error of a component
    return float(1 / curvature) if curvature else float("inf")


# |log| of the median imprint's width over its height, and its standard errors. Six real sets have 0.10 or less, and 0.19 or
# more where one side of their pixels is made 1.25 times as long.
ELLIPTIC, ELLIPTIC_SIGMAS = 0.15, 3.0
# Change of color per slope, of the middle channel. Nine real sets have 0.4 to 1.3; a ball ten times too large 4 or more.
MAX_RESPONSE = 3.0


def check_inputs(presses: Presses) -> None:
    """Refuse a set without presses, or with gray, turned, mirrored or BGR images.

    The CalibrationError names the images and the remedy.
    """
    if not presses.presses:
        count = len(presses.flats)
        flats = f"{count} of flat punches, which gelform only evaluates" if count else "none"
        raise CalibrationError(
            f"Expected presses of a ball in {presses.folder}, got {flats}. Press a ball at {NEEDED.advised.presses} places "
            "and add a row for each to presses.csv."
        )
    names = {press.digest: press.name for press in presses.presses}
    for flat in presses.flats:
        if flat.digest in names:
            raise CalibrationError(
                f"{flat.name} of {presses.folder}, listed as a flat punch {flat.height_mm:g} mm high, is the same image as "
                f"{names[flat.digest]}. Correct the table: one row for each press."
            )
        names[flat.digest] = flat.name
    if all(np.ptp(press.image, axis=-1).max() == 0 for press in presses.presses):
        raise CalibrationError(
            f"The {len(presses.presses)} presses of {presses.folder} are gray: red, green and blue are equal "
            "everywhere. gelform reads slopes from light of three colors from three sides. Use a color camera's images."
        )
    _check_orientation(presses)


def _check_orientation(presses: Presses) -> None:
    wrong: dict[str, list[str]] = {}
    for press in presses.presses:
        orientation = orientation_if_doubtful(press.image, presses.background)
        if orientation is not None and not orientation.is_upright:
            wrong.setdefault(orientation.named, []).append(press.name)
    for how, names in wrong.items():
        if len(names) == len(presses.presses):
            raise CalibrationError(
                f"All {len(names)} presses of {presses.folder} are {how} compared with the background. Either they or the "
                "background image were saved in another way. Save all as RGB files that lie as the camera gives them."
            )
        named = ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")
        raise CalibrationError(
            f"{len(names)} of {len(presses.presses)} presses of {presses.folder} are {how} compared with the background: "
            f"{named}. Save all as RGB files, in the same way."
        )


def background_findings(presses: Presses) -> tuple[Finding, ...]:
    """The finding that something seems to touch the gel in the background; five presses or more are needed to find it.

    Each place is at rest in most presses, so their median shows the gel at rest. Of presses at one place, the median is
    itself touched, and has the structure.
    """
    count = len(presses.presses)
    if not NEEDED.median.met(count):
        return ()
    untouched = np.median(np.stack([presses.presses[k].image for k in _some(count)]), axis=0)
    touch = touch_in_first(presses.background, untouched)
    if touch is None:
        return ()
    x, y, _ = presses.as_read((touch.x_px, touch.y_px, 0))
    return (touch._replace(x_px=round(x), y_px=round(y)).finding("most presses"),)


def make_findings(presses: Presses) -> tuple[Finding, ...]:
    """The finding `make` if the sensor's name is of another make than the presses were read as."""
    named = make_of(presses.sensor_name)
    if named in (None, presses.make):
        return ()
    message = (
        f"The presses were read as those of a {presses.make}, but their sensor is called {presses.sensor_name}. Leave the "
        "make out (--sensor), or correct the name in sensor.toml."
    )
    return (Finding("make", message, 1.0),)


def _some(count: int) -> NDArray[np.intp]:
    """Up to `SAMPLED` numbers below a count, evenly spaced."""
    return np.unique(np.linspace(0, count - 1, min(count, SAMPLED)).round().astype(int))


def first_notes(presses: Presses, readings: Sequence[BallReading]) -> tuple[str, ...]:
    """Notes that the error for too few presses has too: on the background, the images' surround and light, and the ball."""
    same = [one.name for one in presses.presses if np.array_equal(one.image, presses.background)]
    of_rest = [f"{name} is the background image itself. That has to show the gel at rest." for name in same]
    return *of_rest[:1], *surround_notes(presses), *light_notes(presses.background), *notes_of(readings)


def check_places(located: Located) -> None:
    """Raise a CalibrationError if under three presses fit, with the reasons of the others."""
    least, refined, presses = NEEDED.places.presses, located.refined, located.presses
    if len(refined.accepted) >= least:
        return
    rejected = [(row.name, why) for row, why in zip(presses.presses, refined.reasons) if why is not None]
    kinds: dict[str, list[str]] = {}
    for name, why in rejected:  # reasons that differ only in figures are counted together
        kinds.setdefault(re.sub(r"\d[\d.]*", "", why), []).append(f"{name}: {why}")
    most = sorted(kinds.values(), key=len, reverse=True)[:4]
    listed = "; ".join(f"{len(one)} like {one[0]}" for one in most)
    # The first note that is about a cause; a list of all hides the reasons.
    cause = next((f"{note} " for note in located.notes if note != UNCHECKED), "")
    if not rejected:
        cause += "".join(f"{note} " for note in _coverage_notes(located))
    raise CalibrationError(
        f"Expected at least {least} presses of a ball that fit, got {len(refined.accepted)} of "
        f"{len(presses.presses)} in {presses.folder}. Rejected: {listed or 'none'}. "
        f"{cause}Press a ball of known diameter firmly at many places, one image each, best not deeper than half its radius."
    )


def input_notes(located: Located) -> tuple[str, ...]:
    """Notes on the presses for the user: reading, missing places, drift, light, order of the lights."""
    presses = located.presses
    prepared, contacts = located.refined.of_accepted(located.prepared)
    of_light: tuple[str, ...] = ()
    if contacts:
        response = light_response(prepared, contacts)
        of_light = *imprint_notes(response), *light_order_notes(presses.make, response)
    found = check_background_of_frames([press.image for press in presses.presses], presses.background)
    return (
        *presses.notes,
        *_coverage_notes(located),
        *(finding.message for finding in found),
        *_edge_notes(prepared),
        *shape_notes(prepared, contacts),
        *_scale_notes(presses),
        *of_light,
    )


def _coverage_notes(located: Located) -> tuple[str, ...]:
    """Notes on places without a press, in px of the images as read."""
    presses, refined = located.presses, located.refined
    circles = [presses.as_read(refined.contacts[i].circle_px) for i in refined.accepted]
    height, width = (presses.reduced_by * n for n in presses.image_shape)
    return coverage_notes(circles, (height, width), started=located.start is not None)


def surround_notes(presses: Presses) -> tuple[str, ...]:
    """A note if the gel does not fill the image, with the crop that leaves the rest out."""
    found = surround_finding(presses.background, "--crop {}", viewed=not presses.view.is_identity)
    return () if found is None else (found.message,)


def _edge_notes(prepared: Sequence[PreparedPress]) -> tuple[str, ...]:
    """A note if the contact edge lies far inside the visible rim, at less than three quarters of its radius."""
    if not prepared or prepared[0].contact_radius_ratio >= 0.75:
        return ()
    one_size = len({press.ball_radius_px for press in prepared}) == 1
    alike = " A ball that is smaller than stated looks the same. Measure it, or press a second size."
    return (
        f"The contact edge is at {prepared[0].contact_radius_ratio:.2f} of the visible circles' radius. Pixels "
        f"further out do not train, and errors count up to there.{alike if one_size else ''}",
    )


def shape_notes(prepared: Sequence[PreparedPress], contacts: Sequence[ContactCircle]) -> tuple[str, ...]:
    """A note if imprints of a ball are elliptic, as in pixels that are not square; deep ones are no ellipses."""
    shallow = [(press, contact) for press, contact in zip(prepared, contacts) if not press.is_deep(contact)]
    if not NEEDED.edge.met(len(shallow)):
        return ()
    logs = np.log([imprint_aspect(shallow[k][0].size, shallow[k][1]) for k in _some(len(shallow))])
    middle = float(np.median(logs))
    # of a median, from absolute deviations
    error = SIGMA_OF_MEDIAN * sqrt(pi / 2) * float(np.median(np.abs(logs - middle))) / len(logs) ** 0.5
    if abs(middle) < max(ELLIPTIC, ELLIPTIC_SIGMAS * error):
        return ()
    how = "wider than high" if middle > 0 else "higher than wide"
    return (
        f"Imprints are {np.exp(abs(middle)):.2f} times {how}: pixels are not square? Then give mm_per_px = [x, y] in "
        "sensor.toml. Or the camera looks at an angle: gelform lens.",
    )


def imprint_aspect(size: Map, contact: ContactCircle) -> float:
    """Width of an imprint over its height, from |change|: that of the ellipses at which the ring mean falls most steeply."""
    scale, falls, logs = scale_of(size.shape), [], 0.4 * np.linspace(-1, 1, 9)
    low, high = int((1 - RIM) * contact.radius_px), int((1 + RIM) * contact.radius_px + 2 * scale)
    for aspect in np.exp(logs):
        rings = ring_mean(size, contact.x_px, contact.y_px, float(aspect))
        slope = gaussian_filter1d(rings, 2 * scale, order=1)
        falls.append(-float(slope[low : min(high, len(slope) - int(5 * scale))].min(initial=0.0)))
    best = int(np.argmax(falls))
    offset = parabola_offset(np.array(falls), best)
    return float(np.exp(logs[best] + float(logs[1] - logs[0]) * offset))


def _scale_notes(presses: Presses) -> tuple[str, ...]:
    """A note if mm_per_px differs much from that of the sensor's make."""
    if doubt := check_gel_width(presses.image_shape, presses.mm_per_px, presses.make):
        return (doubt,)
    off = scale_off_make(presses.make, presses.image_shape, presses.mm_per_px)
    if off is None or off < SAME_SCALE:
        return ()
    return (
        f"The stated {presses.mm_per_px / presses.reduced_by:g} mm/px differs by {100 * off:.0f} % from that of the make's "
        "images. Check it, or measure it with gelform scale. If it is 1 % off, depth is 2 % off.",
    )


def imprint_notes(response: Numbers) -> tuple[str, ...]:
    """A note if imprints change color more than such slopes can: the stated ball is too large for them."""
    size = float(np.median(np.linalg.norm(response, axis=0)))
    if size < MAX_RESPONSE:
        return ()
    return (
        f"The imprints change color {size:.2g} times as much as their slopes on this ball; on known sensors it "
        "is 0.4 to 1.3 times. The ball's diameter is too large or mm_per_px too small. Measure both: gelform scale.",
    )


def light_order_notes(make: str | None, response: Numbers) -> tuple[str, ...]:
    """A note if the lights are in the opposite order around the gel for this make of sensor.

    If presses and background were both saved as BGR, they agree with each other, and only the lights show it. The direction
    of each light is the slope direction that brightens its channel most.
    """
    if make is None:
        return ()
    turn, expected = light_turn(response), light_order_of(make)
    turned = "clockwise" if turn > 0 else "counter-clockwise"
    if abs(turn) < 0.3 or turned == expected:  # less may be noise
        return ()
    return (
        f"Red, green and blue lights follow each other {turned} around the gel. In a {PROFILES[make].name} the "
        f"order is {expected}. Either all images and the background are saved as BGR, or they are mirrored. A "
        "calibration fits only images of the same kind, so read new ones in the same way.",
    )


def light_turn(response: Numbers) -> float:
    """Direction in which red, green and blue light follow each other around the gel: > 0 clockwise in the image.

    It is the sum of the sines of the turns from one light to the next, up to 2.6 for lights at equal angles.
    """
    towards = np.arctan2(response[1], response[0])  # y is down: a growing angle turns clockwise
    return float(np.sin(np.roll(towards, -1) - towards).sum())


def light_response(prepared: Sequence[PreparedPress], contacts: Sequence[ContactCircle]) -> Numbers:
    """Change of color of each channel per slope (2, 3), by least squares over the balls."""
    samples = contact_samples(prepared, contacts, total=TRIAL_SAMPLES)
    return np.asarray(np.linalg.lstsq(samples.gradients, samples.color_change, rcond=None)[0])
