"""Make the starters that the package ships, from the presses of the units that may be shared.

The calibration of a single unit, or of the only one whose scale is known, is used unchanged. For several units, a common
color model and a common forward response are fitted to the samples of all: each brought to the mean light, and to the place
where it lies in mm on the first unit's image. How far units differ is measured unit against unit: each one's own model reads
the presses of the others. Where no unit's scale is verified, the slopes of each have a free factor, by which each is read
as much too large by the others as it reads them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np

import gelform
from gelform.calibration.circles.find import (
    ColorChanges,
    ContactCircle,
    PreparedPress,
    joined,
    prepared_with,
    training_samples,
)
from gelform.calibration.circles.locate import locate
from gelform.calibration.inputs import INNER
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.selection import SlopeReader, step_sigma_of
from gelform.calibration.starters import (
    Starter,
    gain_between,
    levels_from_light,
    light_from_background,
    pixel_places,
    starter_from_calibration,
)
from gelform.depth.coarse import CoarseDepth
from gelform.result.metrics import ball_center, ball_gradients, score_slopes
from gelform.simulate import LAYOUTS, SimulatedSensor, simulate_ball_presses
from gelform.simulate.light import exposed
from gelform.slopes.color_models import ForwardResponse, HierarchicalModel, Samples
from gelform.slopes.color_models.forward_response import RIDGES
from gelform.slopes.color_models.seam import at_pixels, interpolation
from presses import DATA, presses_of, unlabeled, with_circles

FOLDER = Path(gelform.__file__).parent / "calibration" / "starters"
RIDGE = 1e-3  # strength of that regularization: the middle one of the values that calibration tries
LIKELY = (
    4.70 / 4.0
)  # mini-d's ball: likely over stated diameter, because its contacts are as wide as those of 4.70 mm
REAL = {
    "gelsight-mini": {
        "mini-ball": "a GelSight Mini, 67 presses of balls of 6.31 and 9.50 mm (rpl-cmu/gelslam, MIT)",
        "mini-d": "a second one, 49 presses of a ball of 4.7 mm, for the difference between units alone "
        "(RuihanGao/16741-Proj-ShapeMap3D-GelSightMini, MIT)",
    },
    "digit": {
        "digit-ball": "a DIGIT, 42 presses of a ball of 4.7 mm, scale not verified (Rancho-zhao/FOTS, MIT)",
        "digit-c": "a second one, 14 presses of a ball of 6.0 mm, scale not verified, for the scale and the "
        "difference between units alone (vocdex/digit-depth)",
    },
}
SCALE_DOUBTED = {"digit"}
# Sets that show how far units differ, and do not teach the model. The scale of mini-d is doubtful: with it in the model, an
# unseen Mini without a press was read with 1.92 degrees for 1.69, its radius with 5.9 % for 4.3. digit-c has no license.
SPREAD_ONLY = {"mini-d", "digit-c"}
LAYOUT, UNITS = "three-edges", 4
BALLS_MM, EACH = (4.0, 6.0), 16  # simulated presses: ball diameters, presses per ball


def make(folder: Path = FOLDER) -> None:
    """Write every starter whose data exist."""
    simulated = [simulated_unit(k) for k in range(UNITS)]
    said = f"{UNITS} simulated units of the layout {LAYOUT}, whose lamps and levels differ"
    made = {f"simulated-{LAYOUT}": of_units(simulated, f"simulated-{LAYOUT}", (said,))}
    for sensor, sources in REAL.items():
        if all((DATA / name).is_dir() for name in sources):
            teaching = sum(name not in SPREAD_ONLY for name in sources)
            units = [real_unit(name) for name in sources]
            made[sensor] = of_units(units, sensor, tuple(sources.values()), teaching)
    for sensor, starter in made.items():
        starter.save(folder / f"{sensor}.npz", overwrite=True)
        size = (folder / f"{sensor}.npz").stat().st_size
        print(
            f"{sensor}: {size / 1000:.0f} kB, spread {100 * starter.spread:.1f} %, color variance "
            f"{starter.color_variance:.1f}; {'; '.join(starter.units)}"
        )


def real_unit(name: str) -> Presses:
    """The presses of a set, mini-d's with the likely diameter of its ball."""
    return stated(gelform.read_presses(DATA / name), LIKELY if name == "mini-d" else 1.0)


def stated(presses: Presses, factor: float) -> Presses:
    """The same images, with stated diameters multiplied by a factor."""
    balls = (replace(one, ball_diameter_mm=one.ball_diameter_mm * factor) for one in presses.presses)
    return replace(presses, presses=tuple(balls))


def simulated_unit(number: int, layout: str = LAYOUT) -> Presses:
    """Presses of a unit of a simulated layout; lamps and gel differ slightly between units."""
    rng = np.random.default_rng([31, number])
    presses = simulate_ball_presses(
        varied(LAYOUTS[layout], rng), ball_diameters_mm=BALLS_MM, count=2 * EACH, rng=rng
    )
    return presses_of(presses)


def varied(sensor: SimulatedSensor, rng: np.random.Generator) -> SimulatedSensor:
    """Another unit: lamps 0.5 mm displaced and 10 % brighter or darker, the image's levels 10 % too."""
    leds = tuple(
        replace(
            led,
            position_mm=tuple(float(v) for v in np.array(led.position_mm) + rng.normal(0, 0.5, 3)),
            color=tuple(float(v) for v in np.array(led.color) * np.exp(rng.normal(0, 0.1))),
        )
        for led in sensor.leds
    )
    levels = np.array([78.0, 95.0, 105.0]) * np.exp(rng.normal(0, 0.1, 3))
    return exposed(replace(sensor, leds=leds), tuple(levels))


def of_units(
    units: Sequence[Presses], sensor: str, said: tuple[str, ...], teaching: int | None = None
) -> Starter:
    """The starter of several units: common models of the first `teaching` ones, and how far one's is off on another."""
    own = [gelform.calibrate(unlabeled(one), start=None) for one in units]
    alone = [starter_from_calibration(one, sensor, spread=1.0, units=said) for one in own]
    known = [with_circles(*pair) for pair in zip(units, own)]
    pairs = list(permutations(range(len(units)), 2))
    gains = np.eye(
        len(units)
    )  # mean factor by which a unit's model (row) reads the slopes of another (column)
    for a, b in pairs:
        gains[a, b] = np.mean(gains_on(alone[a], known[b]))
    scales, doubt = scales_of(gains) if sensor in SCALE_DOUBTED else (np.ones(len(units)), 0.0)
    wrong = [gains[a, b] * scales[b] / scales[a] - 1 for a, b in pairs]
    spread = float(np.hypot(np.sqrt(np.mean(np.square(wrong))), doubt))
    count = teaching or len(units)
    errors = [color_error(alone[a], known[b]) for a, b in pairs if a < count]
    units, own, alone = units[:count], own[:count], alone[:count]
    first = alone[0].calibration
    light = np.mean([light_at_scale(one, first.known_mm_per_px) for one in alone], axis=0)
    mean = replace(alone[0], light=light, spread=spread)
    known_scale = count == 1 and scales[0] == 1
    model, forward = (
        (first.color_model, first.forward) if known_scale else common_models(units, own, mean, scales)
    )
    digests = tuple(digest for one in own for digest in one.training_digests)
    everything = replace(first, color_model=model, forward=forward, training_digests=digests)
    if sensor.startswith("simulated"):
        everything = replace(everything, sensor_name=sensor)
    smooth = levels_from_light(
        light, *pixel_places(*(np.arange(n) for n in first.image_shape[::-1]), first.image_shape)
    )
    # A pair of units differs by twice the variance of one, and one differs from the mean of n by 1 + 1/n of it.
    noise = np.mean([one.forward.covariance for one in own], axis=0)
    unseen = noise + (1 + 1 / count) / 2 * (np.mean(errors, axis=0) - noise)
    variance = over(unseen, everything)
    return replace(mean, calibration=replace(everything, background=smooth), color_variance=variance)


def scales_of(gains: np.ndarray) -> tuple[np.ndarray, float]:
    """Factors (n,) by which each unit's slopes are stated too large, and the relative deviation of their mean.

    Only ratios of scales can be measured: the geometric mean of the factors is 1. `gains` (n, n) is how a unit's model (row)
    reads the slopes of another (column).
    """
    logs = (np.log(gains) - np.log(gains.T)).mean(axis=1) / 2
    return np.exp(logs), float(np.std(logs, ddof=1) / np.sqrt(len(logs)))


def unit_of(starter: Starter, background: np.ndarray, mm_per_px: float | None = None) -> gelform.Calibration:
    """The calibration of a unit from its background."""
    return starter.for_unit(background, mm_per_px=mm_per_px)


def over(error: np.ndarray, calibration: gelform.Calibration) -> float:
    """A covariance of colors (3, 3) over the one that a calibration's forward response states."""
    return float(np.trace(np.linalg.solve(calibration.forward.covariance, error)) / 3)


def color_error(starter: Starter, presses: Presses) -> np.ndarray:
    """Mean square (3, 3) of the colors of labeled presses around a starter's response.

    Measured in 0.6 of the circles, at the balls' slopes, with free centers.
    """
    unit = unit_of(starter, presses.background, presses.mm_per_px)
    changes = ColorChanges(presses.background, unit.change)
    depth = CoarseDepth(unit.image_shape, unit.untouched_change)
    model = unit.color_model.prepare(presses.background, unit.image_shape)
    y, x = np.mgrid[: unit.image_shape[0], : unit.image_shape[1]]
    left = []
    for press in presses.presses:
        change = np.ascontiguousarray(changes(press.image)[0])
        read, _ = model.gradients_from_color(change)
        column, row, radius = press.label
        ball_px = press.ball_diameter_mm / 2 / presses.mm_per_px
        inside = np.hypot(x - column, y - row) < min(INNER * radius, 0.9 * ball_px)
        center = ball_center(read[inside], x[inside], y[inside], (column, row), ball_px)
        true, z = ball_gradients(x[inside], y[inside], center, ball_px), depth.at_pixels(change, read)[inside]
        left.append(
            change[inside] - unit.forward.color_from_gradients(true, x[inside], y[inside], depth_px=z)
        )
    error = np.concatenate(left)
    return error.T @ error / len(error)


def gains_on(starter: Starter, presses: Presses) -> list[float]:
    """Slopes that a starter gives on each labeled press of another unit, over the ball's, inside the contact."""
    unit = unit_of(starter, presses.background, presses.mm_per_px)
    reconstruct, gains = gelform.Reconstructor(unit), []
    y, x = np.mgrid[: unit.image_shape[0], : unit.image_shape[1]]
    for press in presses.presses:
        column, row, radius = press.label
        ball_px = press.ball_diameter_mm / 2 / presses.mm_per_px
        inside = np.hypot(x - column, y - row) < min(INNER * radius, 0.9 * ball_px)
        slopes = reconstruct.from_image(press.image).gradients[inside]
        true = score_slopes(slopes, x[inside], y[inside], (column, row), ball_px).true_gradients
        gains.append(float((slopes * true).sum() / np.square(true).sum()))
    return gains


def light_at_scale(starter: Starter, mm_per_px: float) -> np.ndarray:
    """The light of a unit on images of another scale, whose middle is the same."""
    height, width = starter.calibration.image_shape
    wider = mm_per_px / starter.calibration.known_mm_per_px
    places = pixel_places(np.arange(width), np.arange(height), (height, width))
    image = levels_from_light(starter.light, *(0.5 + wider * (along - 0.5) for along in places))
    return light_from_background(image)


def common_models(
    units: Sequence[Presses], own: Sequence[gelform.Calibration], mean: Starter, scales: np.ndarray
) -> tuple[HierarchicalModel, ForwardResponse]:
    """Color model and forward response of the samples of several units, all as they were on the first one's images.

    The slopes of each are divided by its factor in `scales` (n,).
    """
    made, parts, deep = mean.calibration, [], []
    pressed = [pressed_of(presses, made.change.offset) for presses in units]
    for presses, one, scale in zip(units, pressed, scales):
        parts.append(as_first(training_samples(*one), mean, presses, scale))
    common = HierarchicalModel.fit(joined(parts), ridge=RIDGE)
    for presses, one, calibration, scale in zip(units, pressed, own, scales):
        light = light_from_background(presses.background)
        model, _ = replace(mean, calibration=replace(made, color_model=common)).models_for(
            light, presses.mm_per_px
        )
        reader = SlopeReader(model, one[0][0], calibration.untouched_change)
        known = [replace(press, depth_px=reader.depth_px(press)) for press in one[0]]
        deep.append(as_first(training_samples(known, one[1]), mean, presses, scale))
    samples = joined(deep)
    ridge = made.settings.step_ridge or RIDGES[0]
    (forward,) = ForwardResponse.fit_each(samples, [ridge], step_sigma=step_sigma_of(common, samples))
    return common, replace(forward, residual_scale=made.forward.residual_scale, clipped=made.forward.clipped)


def pressed_of(presses: Presses, offset: float) -> tuple[list[PreparedPress], list[ContactCircle]]:
    """The accepted presses of a unit and their circles."""
    located = locate(unlabeled(presses))
    return located.refined.of_accepted(prepared_with(located.presses, located.prepared, offset))


def as_first(samples: Samples, mean: Starter, presses: Presses, scale: float) -> Samples:
    """Samples of a unit as they were on the first one's images, under the mean light: those that lie on them.

    Their slopes are divided by `scale`.
    """
    made, light = mean.calibration, light_from_background(presses.background)
    wider = presses.mm_per_px / made.known_mm_per_px
    nodes = gain_between(light, mean.light, made.change.offset, samples.shape, wider)
    gain = at_pixels(nodes, *interpolation(samples.x_px, samples.y_px, samples.shape))
    middle = (np.array(samples.shape[::-1]) - 1) / 2
    x, y = (half + wider * (at - half) for half, at in zip(middle, (samples.x_px, samples.y_px)))
    on = (np.abs(x - middle[0]) <= middle[0]) & (np.abs(y - middle[1]) <= middle[1])
    change = (samples.color_change * gain).astype(np.float32)
    columns = {"color_change": change, "x_px": x, "y_px": y}
    columns |= {"gradients": samples.gradients / scale, "weight": samples.weight}
    if samples.depth_px is not None:
        columns["depth_px"] = wider * samples.depth_px
    return replace(
        samples, background=made.background, **{name: values[on] for name, values in columns.items()}
    )
