"""Make the starters that the package ships, from the presses of the units that may be shared.

The calibration of a single unit is used unchanged. For several units, a common model is fitted to the samples of all, each
brought to their mean light. Each unit's own model is then regularized towards the common one. The spread is the
difference of the units' slopes from the common model's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import gelform
from gelform.calibration.balls import INNER
from gelform.calibration.candidates import training_samples
from gelform.calibration.circles.locate import locate
from gelform.calibration.circles.prepare import ColorChanges, prepared_by_offset
from gelform.calibration.circles.samples import joined
from gelform.color_models import HierarchicalModel, Samples
from gelform.color_models._shared.least_squares import at_pixels, interpolation
from gelform.color_models.stepped import FrameDepth
from gelform.metrics.ball import ball_center, ball_gradients
from gelform.simulate import LAYOUTS, SimulatedSensor, simulate_ball_presses
from gelform.simulate.render import exposed
from gelform.starters.light import gain_between, light_from_background
from gelform.starters.starter import Starter, starter_from_calibration
from presses import DATA, labeled, presses_of, unlabeled

FOLDER = Path(gelform.__file__).parent / "starters"
RIDGE = 1e-3  # strength of that regularization: the middle one of the values that calibration tries
# Ratio of color variances: a unit's colors around the response of another unit, over those around its own. Measured:
# mini-d by mini-ball 11, mini-ball by mini-d 16. There are no presses of a second DIGIT, so the same value is assumed
# for it.
COLOR_VARIANCE = 11.0
# Relative spread of slopes, measured. Minis: the model of one unit read the balls of two others 5.0 % too large and
# 1.9 % too small. DIGITs: another unit's ball was read 10 % too large.
SPREAD = {"gelsight-mini": 0.06, "digit": 0.10}
REAL = {
    "gelsight-mini": (
        "mini-ball",
        "one GelSight Mini, 67 presses of balls of 6.31 and 9.50 mm (rpl-cmu/gelslam, MIT)",
    ),
    "digit": (
        "digit-ball",
        "one DIGIT, 42 presses of a ball of 4.7 mm, scale not verified (Rancho-zhao/FOTS, MIT)",
    ),
}
LAYOUT, UNITS = "three-edges", 4
BALLS_MM, EACH = (4.0, 6.0), 16  # simulated presses: ball diameters, presses per ball


def make(folder: Path = FOLDER) -> None:
    """Write every starter whose data exist."""
    made = {f"simulated-{LAYOUT}": of_units([simulated_unit(k) for k in range(UNITS)], LAYOUT)}
    for sensor, (name, said) in REAL.items():
        if (DATA / name).is_dir():
            presses = unlabeled(gelform.read_presses(DATA / name))
            calibration = gelform.calibrate(presses, start=None)
            made[sensor] = starter_from_calibration(
                calibration, sensor, spread=SPREAD[sensor], units=(said,), color_variance=COLOR_VARIANCE
            )
    for sensor, starter in made.items():
        starter.save(folder / f"{sensor}.npz", overwrite=True)
        size = (folder / f"{sensor}.npz").stat().st_size
        print(
            f"{sensor}: {size / 1000:.0f} kB, spread {100 * starter.spread:.1f} %, {'; '.join(starter.units)}"
        )


def simulated_unit(number: int, layout: str = LAYOUT) -> gelform.Presses:
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


def of_units(units: Sequence[gelform.Presses], layout: str) -> Starter:
    """The starter from several units' presses: the mean of their models, and their spread around it."""
    first = gelform.calibrate(unlabeled(units[0]), start=None)
    lights = [light_from_background(one.background)[0] for one in units]
    mean = starter_from_calibration(first, f"simulated-{layout}", spread=1.0, units=())
    mean = replace(mean, light=np.mean(lights, axis=0))
    samples = [samples_of(one, light, mean) for one, light in zip(units, lights)]
    common = HierarchicalModel.fit(joined(samples), ridge=RIDGE)
    offs = []
    for own in samples:
        drawn = HierarchicalModel.fit(own, ridge=RIDGE, start=common)
        slopes, of_common = (m.gradients_at(own.color_change, own.x_px, own.y_px) for m in (drawn, common))
        pressed = np.linalg.norm(own.gradients, axis=1) > 0
        square = np.sum((slopes - of_common)[pressed] ** 2), np.sum(of_common[pressed] ** 2)
        offs.append(square[0] / square[1])
    spread = float(np.sqrt(np.mean(offs) * len(offs) / (len(offs) - 1)))
    calibration = replace(first, color_model=common, forward=mean.models_for(lights[0])[1])
    named = replace(calibration, sensor_name=f"simulated-{layout}")
    said = f"{len(units)} simulated units of the layout {layout}, whose lamps and levels differ"
    smooth = replace(named, background=mean.calibration.background)
    made = replace(mean, calibration=smooth, spread=spread, units=(said,))
    ratios = [color_variance(made, labeled(one)) for one in units]
    return replace(made, color_variance=float(np.mean(ratios) * len(ratios) / (len(ratios) - 1)))


def color_variance(starter: Starter, presses: gelform.Presses) -> float:
    """Variance of the colors of labeled presses around the starter's response, over the variance that the response states.

    Measured in 0.6 of the circles, at the balls' slopes, with free centers.
    """
    unit = starter.for_unit(presses.background, mm_per_px=presses.mm_per_px)
    changes = ColorChanges(presses.background, unit.change)
    depth = FrameDepth(unit.image_shape, unit.untouched_change)
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


def samples_of(presses: gelform.Presses, light: np.ndarray, mean: Starter) -> Samples:
    """Training samples of one unit, with color changes brought to the mean light."""
    located = locate(unlabeled(presses))
    offset = mean.calibration.change.offset
    prepared = prepared_by_offset(located.presses, located.prepared, {offset})[offset]
    samples = training_samples(*located.refined.of_accepted(prepared))
    nodes = gain_between(light, mean.light, offset, samples.shape)
    gain = at_pixels(nodes, *interpolation(samples.x_px, samples.y_px, samples.shape))
    return replace(samples, color_change=(samples.color_change * gain).astype(np.float32))
