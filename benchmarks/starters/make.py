"""Make the starters that the package ships, from the presses of the units that may be shared.

The calibration of a single unit, or of the only one whose scale is known, is used unchanged. For several units, a common
color model and a common forward response are fitted to the samples of all: each brought to the mean light, and to the place
where it lies in mm on the first unit's image. How far units differ is measured unit against unit: each one's own model reads
the presses of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
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
# There are no presses of a second DIGIT. Spread of slopes: another unit's ball was read 10 % too large. The ratio of color
# variances (see `color_variance`) is that of the two Minis before their places were equal in mm.
SPREAD_OF_DIGITS, VARIANCE_OF_DIGITS = 0.10, 11.0
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
        "digit-ball": "one DIGIT, 42 presses of a ball of 4.7 mm, scale not verified (Rancho-zhao/FOTS, MIT)"
    },
}
# Sets that show how far units differ, and do not teach the model, because their scale is doubtful. With mini-d in the model,
# an unseen Mini without a press was read with 1.92 degrees for 1.69, its radius with 5.9 % for 4.3.
SPREAD_ONLY = {"mini-d"}
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
    alone = [starter_from_calibration(one, sensor, spread=SPREAD_OF_DIGITS, units=said) for one in own]
    if len(units) == 1:
        return replace(alone[0], color_variance=VARIANCE_OF_DIGITS)
    known = [with_circles(*pair) for pair in zip(units, own)]
    pairs = [(one, presses) for one in alone for other, presses in zip(alone, known) if other is not one]
    gains = np.array([np.mean(gains_on(*pair)) for pair in pairs])
    spread = float(np.sqrt(np.mean(np.square(gains - 1))))
    variance = float(np.mean([color_variance(*pair) for pair in pairs]))
    if teaching == 1:
        return replace(alone[0], spread=spread, color_variance=variance)
    units, own, alone = units[:teaching], own[:teaching], alone[:teaching]
    first = alone[0].calibration
    light = np.mean([light_at_scale(one, first.known_mm_per_px) for one in alone], axis=0)
    mean = replace(alone[0], light=light, spread=spread, color_variance=variance)
    model, forward = common_models(units, own, replace(mean, color_variance=1.0))
    digests = tuple(digest for one in own for digest in one.training_digests)
    everything = replace(first, color_model=model, forward=forward, training_digests=digests)
    if sensor.startswith("simulated"):
        everything = replace(everything, sensor_name=sensor)
    smooth = levels_from_light(
        light, *pixel_places(*(np.arange(n) for n in first.image_shape[::-1]), first.image_shape)
    )
    return replace(mean, calibration=replace(everything, background=smooth))


def unit_of(starter: Starter, background: np.ndarray, mm_per_px: float | None = None) -> gelform.Calibration:
    """The calibration of a unit from its background."""
    return starter.for_unit(background, mm_per_px=mm_per_px)


def color_variance(starter: Starter, presses: Presses) -> float:
    """Variance of the colors of labeled presses around the starter's response, over the variance that the response states.

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
    return float(np.trace(np.linalg.solve(unit.forward.covariance, error.T @ error / len(error))) / 3)


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
    units: Sequence[Presses], own: Sequence[gelform.Calibration], mean: Starter
) -> tuple[HierarchicalModel, ForwardResponse]:
    """Color model and forward response of the samples of several units, all as they were on the first one's images."""
    made, parts, deep = mean.calibration, [], []
    pressed = [pressed_of(presses, made.change.offset) for presses in units]
    for presses, one in zip(units, pressed):
        parts.append(as_first(training_samples(*one), mean, presses))
    common = HierarchicalModel.fit(joined(parts), ridge=RIDGE)
    for presses, one, calibration in zip(units, pressed, own):
        light = light_from_background(presses.background)
        model, _ = replace(mean, calibration=replace(made, color_model=common)).models_for(
            light, presses.mm_per_px
        )
        reader = SlopeReader(model, one[0][0], calibration.untouched_change)
        known = [replace(press, depth_px=reader.depth_px(press)) for press in one[0]]
        deep.append(as_first(training_samples(known, one[1]), mean, presses))
    samples = joined(deep)
    ridge = made.settings.step_ridge or RIDGES[0]
    (forward,) = ForwardResponse.fit_each(samples, [ridge], step_sigma=step_sigma_of(common, samples))
    return common, replace(forward, residual_scale=made.forward.residual_scale, clipped=made.forward.clipped)


def pressed_of(presses: Presses, offset: float) -> tuple[list[PreparedPress], list[ContactCircle]]:
    """The accepted presses of a unit and their circles."""
    located = locate(unlabeled(presses))
    return located.refined.of_accepted(prepared_with(located.presses, located.prepared, offset))


def as_first(samples: Samples, mean: Starter, presses: Presses) -> Samples:
    """Samples of a unit as they were on the first one's images, under the mean light: those that lie on them."""
    made, light = mean.calibration, light_from_background(presses.background)
    wider = presses.mm_per_px / made.known_mm_per_px
    nodes = gain_between(light, mean.light, made.change.offset, samples.shape, wider)
    gain = at_pixels(nodes, *interpolation(samples.x_px, samples.y_px, samples.shape))
    middle = (np.array(samples.shape[::-1]) - 1) / 2
    x, y = (half + wider * (at - half) for half, at in zip(middle, (samples.x_px, samples.y_px)))
    on = (np.abs(x - middle[0]) <= middle[0]) & (np.abs(y - middle[1]) <= middle[1])
    change = (samples.color_change * gain).astype(np.float32)
    columns = {"color_change": change, "x_px": x, "y_px": y}
    columns |= {"gradients": samples.gradients, "weight": samples.weight}
    if samples.depth_px is not None:
        columns["depth_px"] = wider * samples.depth_px
    return replace(
        samples, background=made.background, **{name: values[on] for name, values in columns.items()}
    )
