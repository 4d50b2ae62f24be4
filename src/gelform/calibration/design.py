"""Comparison of LED layouts before they are built: each is simulated, calibrated, reconstructed and drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.fit import calibrate
from gelform.calibration.presses.press_set import presses_from_simulated
from gelform.errors import CalibrationError, Progress, SensorError, no_progress
from gelform.exchange.plots import canvas, draw_map, pixels_of
from gelform.foundations.checks import check_positive
from gelform.image.view import PIXEL_VARIANCE
from gelform.reconstruct import Reconstructor
from gelform.result.metrics import angle_deg
from gelform.simulate import Optics, SimulatedSensor, exposed, simulate_background, simulate_ball_presses
from gelform.simulate.gel import Surface
from gelform.simulate.light import irradiance_from_surface, levels_from_irradiance, spread_in_gel

__all__ = ["DesignResult", "VARIATIONS", "Variation", "compare_designs", "design_picture", "light_quality"]

VARIED = 1.5  # factor of what a variation changes
CELLS = (6, 8)  # rows and columns of the map of depth errors; each cell holds some presses


@dataclass(frozen=True)
class Variation:
    """The difference of a design from the given sensor; factors, 1 for no change.

    `whiteness` moves each light's color from its own (0) to white of the same sum (1).
    """

    name: str
    led_height: float = 1.0
    led_distance: float = 1.0
    noise: float = 1.0
    crosstalk: float = 1.0
    relaxation: float = 1.0
    whiteness: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.whiteness <= 1:
            raise ValueError(f"Expected whiteness in 0-1, got {self.whiteness}.")
        for what in ("led_height", "led_distance", "relaxation"):
            check_positive(getattr(self, what), what)
        if self.noise < 0 or self.crosstalk < 0:
            raise ValueError(f"Expected noise and crosstalk >= 0, got {self.noise} and {self.crosstalk}.")

    def of(self, sensor: SimulatedSensor) -> SimulatedSensor:
        """The changed sensor, exposed to the same mean levels."""
        leds = []
        for led in sensor.leds:
            x, y, z = led.position_mm
            place = (x * self.led_distance, y * self.led_distance, z * self.led_height)
            gray = sum(led.color) / 3
            red, green, blue = ((1 - self.whiteness) * c + self.whiteness * gray for c in led.color)
            leds.append(replace(led, position_mm=place, color=(red, green, blue)))
        crosstalk = np.asarray(sensor.crosstalk, dtype=np.float64)
        mixed = crosstalk * np.where(np.eye(3) > 0, 1, self.crosstalk)
        rows: Any = tuple((float(a), float(b), float(c)) for a, b, c in mixed)
        changed = replace(
            sensor,
            leds=tuple(leds),
            noise_sd=sensor.noise_sd * self.noise,
            noise_gain=sensor.noise_gain * self.noise**2,
            crosstalk=rows,
            relaxation_mm=sensor.relaxation_mm * self.relaxation,
        )
        means = simulate_background(sensor, None, quantise=False).mean(axis=(0, 1))
        return exposed(changed, (float(means[0]), float(means[1]), float(means[2])))


VARIATIONS = (
    Variation("as given"),
    Variation(f"lights {VARIED} x higher", led_height=VARIED),
    Variation(f"lights {VARIED} x lower", led_height=1 / VARIED),
    Variation("lights half white", whiteness=0.5),
    Variation("no crosstalk", crosstalk=0.0),
    Variation("twice the noise", noise=2.0),
    Variation(f"gel relaxes {VARIED} x farther", relaxation=VARIED),
)


@dataclass(frozen=True)
class DesignResult:
    """The quality of a design.

    Attributes
    ----------
    name : str
    sensor : SimulatedSensor
    condition : (H, W), condition number of the light matrix at rest: 1 is even; a large one is blind in some direction
    slope_sigma : (H, W), the least standard deviation of a slope that one pixel's noise allows, mm/mm
    depth_rmse_um : RMS depth error of the test presses inside the contact, um
    depth_rmse_se_um : its standard error over the presses; designs that differ by less are alike
    depth_map_um : (6, 8), RMS depth error over the gel, um; NaN without a test press
    normal_deg : mean angle error of the normals inside the contact, degrees
    """

    name: str
    sensor: SimulatedSensor
    condition: NDArray[np.float64]
    slope_sigma: NDArray[np.float64]
    depth_rmse_um: float
    depth_rmse_se_um: float
    depth_map_um: NDArray[np.float64]
    normal_deg: float


def compare_designs(
    sensor: SimulatedSensor,
    variations: Sequence[Variation] = VARIATIONS,
    *,
    ball_diameters_mm: Sequence[float] = (6.0, 9.0),
    presses: int = 14,
    tests: int = 16,
    seed: int = 0,
    halved: bool = True,
    color_model: str = "polynomial",
    progress: Progress = no_progress,
) -> tuple[DesignResult, ...]:
    """Simulate, calibrate and reconstruct each variation of a sensor, on the same presses.

    Parameters
    ----------
    presses, tests : number of presses for calibration, and of others for the measurement
    halved : whether to use half the resolution, which is four times as fast; depth is a little noisier

    Raises
    ------
    SensorError
        A design cannot be made, for example without light in a channel.
    CalibrationError
        A design cannot be calibrated, for example without light from three sides.
    """
    if presses < 4 or tests < 1 or len(variations) == 0:
        raise ValueError(
            f"Expected presses >= 4, tests >= 1 and a variation, got {presses}, {tests}, {len(variations)}."
        )
    if halved:
        (height, width), pitch, blur_px = sensor.shape, 2 * sensor.mm_per_px, sensor.blur_px / 2
        sensor = replace(sensor, shape=(height // 2, width // 2), mm_per_px=pitch, blur_px=blur_px)
    designs, results = [], []
    for variation in variations:
        try:
            designs.append(variation.of(sensor))
        except ValueError as problem:
            raise SensorError(f"The design {variation.name!r} cannot be made. {problem}") from problem
    for k, (variation, design) in enumerate(zip(variations, designs)):
        progress(k, len(variations), variation.name)
        train_rng, test_rng = np.random.default_rng(seed).spawn(2)
        balls = list(ball_diameters_mm)
        training = simulate_ball_presses(design, ball_diameters_mm=balls, count=presses, rng=train_rng)
        held_out = simulate_ball_presses(design, ball_diameters_mm=balls, count=tests, rng=test_rng)
        try:
            calibration = calibrate(presses_from_simulated(training), color_model=color_model)
        except CalibrationError as problem:
            raise CalibrationError(
                f"Expected designs that {presses} presses can calibrate, got {variation.name!r}, which they cannot: give it "
                f"light of three colors from three sides, or give more presses= (--presses). {problem}"
            ) from problem
        reconstruct = Reconstructor(calibration)
        errors = []
        for press in held_out.presses:
            inside, result = press.contact, reconstruct.from_image(press.image)
            angles = angle_deg(result.gradients[inside], press.gradients[inside])
            errors.append((np.argwhere(inside), result.depth_mm[inside] - press.depth_mm[inside], angles))
        condition, sigma = light_quality(design)
        results.append(DesignResult(variation.name, design, condition, sigma, *_summed(errors, design.shape)))
    progress(len(variations), len(variations), "done")
    return tuple(results)


def light_quality(sensor: SimulatedSensor) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Condition number (H, W) of the light matrix, and the least noise (H, W) of a slope.

    The light matrix J (3x2) is the change of the three levels per slope, each divided by its noise, for gel at
    rest. It comes from central differences of the whole simulated path except noise, so that crosstalk, ambient and
    scattered light count. The slope's standard deviation is the square root of half the trace of (J^T J)^-1 (Cramer and
    Rao).
    """
    plain = replace(sensor, optics=Optics())
    rest = _levels_of_slope(plain, 0.0, 0.0)
    step = 1e-3  # mm/mm, of a slope
    columns = [
        (_levels_of_slope(plain, px, py) - _levels_of_slope(plain, -px, -py)) / (2 * step)
        for px, py in ((step, 0.0), (0.0, step))
    ]
    variance = sensor.noise_sd**2 + sensor.noise_gain * rest + PIXEL_VARIANCE  # of rounding to gray levels
    matrix = np.stack(columns, axis=-1) / np.sqrt(variance)[..., None]
    singular = np.linalg.svd(matrix, compute_uv=False)
    smallest = np.maximum(singular[..., 1], 1e-9 * singular[..., 0])
    sigma = np.sqrt(0.5 * (singular[..., 0] ** -2.0 + smallest**-2.0))
    return singular[..., 0] / smallest, sigma


def _levels_of_slope(sensor: SimulatedSensor, p: float, q: float) -> NDArray[np.float64]:
    """Levels of a gel with the same slope everywhere, at height 0."""
    x, y = sensor.grid_mm()
    gradients = np.empty((*sensor.shape, 2))
    gradients[...] = p, q
    surface = Surface(x, y, np.zeros(sensor.shape), gradients, np.zeros(sensor.shape, dtype=bool))
    coating = sensor.coating
    light = irradiance_from_surface(
        surface, sensor.leds, specular=coating.specular, shininess=coating.shininess
    )
    return np.asarray(levels_from_irradiance(sensor, spread_in_gel(light, coating, sensor.mm_per_px)))


def _summed(
    errors: Sequence[tuple[NDArray[Any], NDArray[Any], NDArray[Any]]], shape: tuple[int, int]
) -> tuple[float, float, NDArray[np.float64], float]:
    """Depth RMSE in um, its standard error over the presses, its map over the gel, and the mean angle error.

    Each press has the positions (N, 2) of its pixels, their depth errors in mm and their angle errors in degrees.
    """
    where, depth, angle = (np.concatenate(parts) for parts in zip(*errors))
    cell = where * np.array(CELLS) // np.array(shape)
    number = np.ravel_multi_index((cell[:, 0], cell[:, 1]), CELLS)
    count = np.bincount(number, minlength=CELLS[0] * CELLS[1])
    square = np.bincount(number, weights=depth**2, minlength=CELLS[0] * CELLS[1])
    mean = np.divide(square, count, out=np.full(square.shape, np.nan), where=count > 0)
    rmse = float(np.sqrt(np.mean(depth**2)))
    squares = [np.mean(one**2) for _, one, _ in errors]
    # by the derivative of the square root
    scatter = float(np.std(squares) / np.sqrt(len(squares)) / (2 * rmse))
    return 1000 * rmse, 1000 * scatter, 1000 * np.sqrt(mean).reshape(CELLS), float(angle.mean())


def design_picture(results: Sequence[DesignResult]) -> NDArray[np.uint8]:
    """Draw one column per design and one row per map, each with its median and one color scale; white: no test press.

    The last row shows the gel with its LEDs as dots in their colors; the other rows show the gel alone.

    Returns
    -------
    picture : (h, w, 3) uint8, RGB

    Raises
    ------
    GelformError
        matplotlib is not installed.
    """
    rows = (
        ("depth error, um", [r.depth_map_um for r in results]),
        ("slope noise of a pixel", [r.slope_sigma for r in results]),
        ("condition of the lights", [r.condition for r in results]),
    )
    figure = canvas(3 * len(results), 2 * len(rows))
    axes = figure.subplots(len(rows), len(results), squeeze=False)
    for row, (label, values) in enumerate(rows):
        low = np.nanmin([np.nanmin(v) for v in values])
        high = np.nanmax([np.nanquantile(v, 0.98) for v in values])
        for column, (value, result) in enumerate(zip(values, results)):
            height, width = (n * result.sensor.mm_per_px / 2 for n in result.sensor.shape)
            extent = (-width, width, height, -height)
            drawn = draw_map(axes[row, column], value, "", cmap="viridis", vmin=low, vmax=high, extent=extent)
            if row == len(rows) - 1:
                _draw_leds(axes[row, column], result)
            axes[row, column].set_xlabel(f"median {np.nanmedian(value):.3g}", fontsize=8)
        figure.colorbar(drawn, ax=list(axes[row]), label=label)
    for column, result in enumerate(results):
        title = f"{result.name}\n{result.depth_rmse_um:.0f} ± {result.depth_rmse_se_um:.0f} um, {result.normal_deg:.1f}°"
        axes[0, column].set_title(title, fontsize=8)
    return pixels_of(figure)


def _draw_leds(axes: Any, result: DesignResult) -> None:
    """Draw the LEDs around the gel, to scale."""
    height, width = (n * result.sensor.mm_per_px / 2 for n in result.sensor.shape)
    for led in result.sensor.leds:
        x, y, _ = led.position_mm
        color = np.asarray(led.color) / max(led.color)
        axes.plot(x, y, "o", color=tuple(color), markersize=4, markeredgecolor="black", markeredgewidth=0.5)
    places = np.abs([led.position_mm for led in result.sensor.leds])
    x, y = (1.1 * max(size, at.max()) for size, at in zip((width, height), places.T))
    axes.set(xlim=(-x, x), ylim=(y, -y))
