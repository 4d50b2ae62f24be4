"""The simulated sensor: its coating, its lights, its optics and its time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gelform.arrays import Array, Numbers
from gelform.foundations.checks import (
    check_map,
    check_mm_per_px,
    check_numbers,
    check_positive,
    check_within,
)
from gelform.simulate.gel import Gel

Grid = tuple[int, int]


def check_not_negative(settings: Any, *names: str) -> None:
    """Refuse settings of these names that are below 0 or not finite."""
    for name in names:
        if not 0 <= getattr(settings, name) < np.inf:
            raise ValueError(f"Expected {name} >= 0, got {getattr(settings, name)}.")


def check_fraction(settings: Any, *names: str) -> None:
    """Refuse settings of these names that are not in 0-1, 1 excluded."""
    for name in names:
        if not 0 <= getattr(settings, name) < 1:
            raise ValueError(f"Expected {name} in 0-1 (1 excluded), got {getattr(settings, name)}.")


@dataclass(frozen=True)
class Coating:
    """The reflecting layer on the gel. With all zeros it is perfectly white and Lambertian.

    Attributes
    ----------
    specular : float, >= 0, strength of the gloss relative to the diffuse light (Blinn-Phong)
    shininess : int, 1-1024, a power of two, exponent of the gloss: larger is sharper
    scattering : float, 0-1, scattering_mm : float
        Part of the light that spreads in the gel before it is visible, and the length (standard deviation).
    interreflection : float, 0-1, interreflection_mm : float
        Part of the reflected light that returns from gel and walls in one bounce, and the length of its spread.
    roughness : standard deviation of the coating's own slopes, mm/mm, that shade but are no depth
    grain_mm : size of the roughness's grains
    scratches, dust : number of them; dust is dark or bright specks
    marker_pitch_mm, marker_radius_mm : of dark dots on a grid; 0 pitch: none
    marker_missing, marker_broken, marker_jitter : float, 0-1
        Fractions of dots that are missing and that lost a piece; distance of dots from the grid, in pitches.
    albedo : (h, w) or None, reflectance 0-1 over the image, stretched to its size
    seed : of this gel's own roughness, scratches and dust; another gel needs another seed
    """

    specular: float = 0.0
    shininess: int = 16
    scattering: float = 0.0
    scattering_mm: float = 0.5
    interreflection: float = 0.0
    interreflection_mm: float = 5.0
    roughness: float = 0.0
    grain_mm: float = 0.12
    scratches: int = 0
    dust: int = 0
    marker_pitch_mm: float = 0.0
    marker_radius_mm: float = 0.25
    marker_missing: float = 0.0
    marker_broken: float = 0.0
    marker_jitter: float = 0.0
    albedo: Any = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_not_negative(self, "specular", "roughness", "marker_pitch_mm", "scratches", "dust", "seed")
        check_fraction(
            self, "scattering", "interreflection", "marker_missing", "marker_broken", "marker_jitter"
        )
        for name in ("scattering_mm", "interreflection_mm", "grain_mm", "marker_radius_mm"):
            check_positive(getattr(self, name), name)
        if self.shininess not in [2**k for k in range(11)]:
            raise ValueError(f"Expected shininess as a power of two in 1-1024, got {self.shininess}.")
        if 0 < self.marker_pitch_mm <= 2 * self.marker_radius_mm:
            raise ValueError(f"Expected marker_pitch_mm over twice the radius, got {self.marker_pitch_mm}.")
        if self.albedo is not None and not isinstance(self.albedo, _Albedo):
            object.__setattr__(self, "albedo", _Albedo(self.albedo))

    def markers_mm(self, shape: Grid, mm_per_px: float) -> Numbers:
        """Positions (N, 2) of the markers at rest: a grid about the center, to half a pitch beyond the image."""
        if self.marker_pitch_mm == 0:
            return np.zeros((0, 2))
        half_x, half_y = (n * mm_per_px / 2 for n in shape[::-1])
        nx, ny = (int(half / self.marker_pitch_mm + 0.5) for half in (half_x, half_y))
        y, x = np.mgrid[-ny : ny + 1, -nx : nx + 1] * self.marker_pitch_mm
        places = np.stack([x.ravel(), y.ravel()], axis=-1)
        rng = np.random.default_rng([self.seed, 3])
        there = rng.random(len(places)) >= self.marker_missing
        away = rng.uniform(-1, 1, places.shape) * self.marker_jitter * self.marker_pitch_mm / 2
        return (places + away)[there]

    def marker_bites(self, count: int) -> Numbers:
        """Center (N, 2), in radii, of the round piece of 0.6 of its radius that each marker lost; NaN: it is whole."""
        rng = np.random.default_rng([self.seed, 4])
        angle, broken = rng.uniform(0, 2 * np.pi, count), rng.random(count) < self.marker_broken
        bites = 0.85 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return np.where(broken[:, None], bites, np.nan)


class _Albedo:
    """A reflectance map that compares by identity, so that a coating can be a key."""

    def __init__(self, values: ArrayLike) -> None:
        self.values = check_map(values, "albedo", nonnegative=True, dtype=np.float64)
        if self.values.ndim != 2 or self.values.max() > 1:
            raise ValueError(
                f"Expected albedo of shape (h, w) in 0-1, got {self.values.shape}, up to {self.values.max():g}."
            )


Triple = tuple[float, float, float]
RED: Triple = (1, 0, 0)
GREEN: Triple = (0, 1, 0)
BLUE: Triple = (0, 0, 1)
SHADING_DEGREES = {6: 2, 15: 4}  # number of coefficients of a polynomial in two variables: its degree
IDENTITY: tuple[Triple, Triple, Triple] = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


@dataclass(frozen=True)
class Led:
    """A small light near the gel; without a beam it shines equally in all directions.

    Attributes
    ----------
    position_mm : (x, y, z), from the gel's center; x to the right, y down, z toward the camera: z > 0
    color : (red, green, blue)
        Strength in each channel, >= 0: gray levels that a white surface facing it gives at 1 mm.
    beam_power : int, 0-64
        Falls off from its axis with this power of the cosine: 0 not at all, 1 Lambert's emitter, more: narrow.
    aim_mm : (x, y, z), the point that its axis goes through; the gel's center by default
    size_mm : diameter; it affects only cast shadows: larger is softer
    """

    position_mm: Triple
    color: Triple
    beam_power: int = 0
    aim_mm: Triple = (0.0, 0.0, 0.0)
    size_mm: float = 1.0

    def __post_init__(self) -> None:
        position = check_numbers(self.position_mm, "position_mm", 3)
        color = check_numbers(self.color, "color", 3)
        if position[2] <= 0:
            raise ValueError(
                f"Expected an LED on the camera's side of the gel (z > 0 mm), got position_mm={self.position_mm}. "
                "z points from the gel toward the camera."
            )
        if min(color) < 0 or max(color) == 0:
            raise ValueError(f"Expected color >= 0 and not all 0, got {self.color}.")
        if check_numbers(self.aim_mm, "aim_mm", 3) == position:
            raise ValueError(f"Expected aim_mm away from the LED itself, got {self.aim_mm}.")
        if int(self.beam_power) != self.beam_power or not 0 <= self.beam_power <= 64:
            raise ValueError(f"Expected beam_power as a whole number in 0-64, got {self.beam_power}.")
        check_not_negative(self, "size_mm")


def led_row(start_mm: Triple, end_mm: Triple, color: Triple, count: int) -> tuple[Led, ...]:
    """`count` equal LEDs from one point to another; together as strong as `color`."""
    each: Triple = (color[0] / count, color[1] / count, color[2] / count)
    points = np.linspace(start_mm, end_mm, count)
    return tuple(Led((float(x), float(y), float(z)), each) for x, y, z in points)


def led_ring(
    distance_mm: float,
    height_mm: float,
    angles_deg: Sequence[float],
    colors: Sequence[Triple] = (RED, GREEN, BLUE),
) -> tuple[Led, ...]:
    """One LED of each color around the gel's center; 0 degrees is to the right, 90 is down."""
    angles = np.deg2rad(angles_deg)
    return tuple(
        Led((float(distance_mm * np.cos(a)), float(distance_mm * np.sin(a)), height_mm), color)
        for a, color in zip(angles, colors)
    )


def led_color(peak_nm: float, width_nm: float = 25.0) -> tuple[float, float, float]:
    """Strength in the three channels of an LED of unit power with a Gaussian spectrum.

    The channels' sensitivities are Gaussians about 600, 540 and 465 nm, 45, 45 and 35 nm wide (standard
    deviations). These are round figures, not measured on a camera. The product of two Gaussians integrates in closed form.

    Parameters
    ----------
    peak_nm : 380-750
    width_nm : full width at half maximum
    """
    if not 380 <= peak_nm <= 750 or not 0 < width_nm < 400:
        raise ValueError(f"Expected peak_nm in 380-750 and width_nm in 0-400, got {peak_nm} and {width_nm}.")
    sd = width_nm / 2.3548
    centers, widths = np.array([600.0, 540.0, 465.0]), np.array([45.0, 45.0, 35.0])
    total = widths**2 + sd**2
    red, green, blue = widths / np.sqrt(total) * np.exp(-((peak_nm - centers) ** 2) / (2 * total))
    return float(red), float(green), float(blue)


@dataclass(frozen=True)
class Optics:
    """A camera over the middle of the gel.

    Attributes
    ----------
    height_mm : float or None
        Height of a pinhole over the gel; a pressed surface is nearer and looks larger. None: orthographic.
    distortion : (k1, k2)
        Radial, Brown's model: a point at distance r from the middle appears at r (1 + k1 r^2 + k2 r^4), r in
        units of half the image's diagonal; k1 < 0 is a barrel.
    response_gamma : gray level = 255 (linear level/255)^(1/gamma): 1 is linear, 2.2 about sRGB
    exposure : factor of the light; noise changes with its signal
    jpeg_quality : int 1-100, or None, of the camera's compression; None: none
    """

    height_mm: float | None = None
    distortion: tuple[float, float] = (0.0, 0.0)
    response_gamma: float = 1.0
    exposure: float = 1.0
    jpeg_quality: int | None = None

    def __post_init__(self) -> None:
        if self.height_mm is not None and not 1 <= self.height_mm < np.inf:
            raise ValueError(f"Expected height_mm >= 1 or None (orthographic), got {self.height_mm}.")
        k1, k2 = check_numbers(self.distortion, "distortion (k1, k2)", 2)
        r = np.linspace(0, 1.2, 200)
        if np.any(np.diff(r * (1 + k1 * r**2 + k2 * r**4)) <= 0):
            raise ValueError(f"Expected distortion that does not fold the image over, got {self.distortion}.")
        check_within(self.response_gamma, "response_gamma", 0.2, 5)
        check_positive(self.exposure, "exposure")
        if self.jpeg_quality is not None and not 1 <= self.jpeg_quality <= 100:
            raise ValueError(f"Expected jpeg_quality in 1-100 or None, got {self.jpeg_quality}.")


@dataclass(frozen=True)
class Timing:
    """A camera's clock and the LEDs' age.

    Attributes
    ----------
    frame_rate_hz : float
    readout_s : from the first row's exposure to the last row's (rolling shutter); 0: all rows at once
    flicker : float, 0-1, flicker_hz : float
        The LEDs' light swings by this part of its mean, at this rate.
    drift : (red, green, blue), drift_time_s : float
        Final change of the light as a part of it, and the time constant of its exponential approach (warming up).
    drop_probability : float, 0-1, of a lost frame; its index is skipped
    """

    frame_rate_hz: float = 25.0
    readout_s: float = 0.0
    flicker: float = 0.0
    flicker_hz: float = 100.0
    drift: Triple = (0.0, 0.0, 0.0)
    drift_time_s: float = 300.0
    drop_probability: float = 0.0

    def __post_init__(self) -> None:
        for name in ("frame_rate_hz", "flicker_hz", "drift_time_s"):
            check_positive(getattr(self, name), name)
        if not 0 <= self.readout_s <= 1 / self.frame_rate_hz:
            raise ValueError(
                f"Expected readout_s between 0 and the frame's time 1/{self.frame_rate_hz:g} s, got {self.readout_s}."
            )
        check_fraction(self, "flicker", "drop_probability")
        if np.shape(self.drift) != (3,) or min(self.drift) <= -1:
            raise ValueError(f"Expected drift as three numbers > -1, got {self.drift}.")

    def light_at(self, time_s: float, rows: int) -> Numbers:
        """The LEDs' light relative to time 0 without flicker, for each row and channel: (rows, 1, 3)."""
        warm = 1 + np.asarray(self.drift) * -np.expm1(-time_s / self.drift_time_s)
        when = time_s + self.readout_s * np.arange(rows) / rows
        swing = 1 + self.flicker * np.sin(2 * np.pi * self.flicker_hz * when)
        light: Array = swing[:, None, None] * warm
        return np.asarray(light, dtype=np.float64)


@dataclass(frozen=True)
class SimulatedSensor:
    """A simulated sensor; `LAYOUTS` holds ready ones.

    Attributes
    ----------
    leds : tuple of Led
    name : str
    shape : (H, W), pixels of the image
    mm_per_px : pixel pitch on the gel, mm
    ambient : (red, green, blue), gray levels of light from all sides (scattered in the gel), before vignetting
    white_balance : (red, green, blue), gain of each channel after the crosstalk; `exposed` finds it
    vignetting : float, 0-1
        Part of the light lost in the image's corners, growing with the square of the distance to the center.
    crosstalk : 3x3, >= 0, row c: the fractions of the red, green, blue light that channel c records
    blur_px : standard deviation of the optics' blur
    noise_sd : read noise, gray levels
    noise_gain : shot noise: variance per gray level of signal
    relaxation_mm : length over which the gel's surface relaxes around the contact
    gel : Gel, thickness, bulge, friction
    coating : Coating, the surface's gloss, scattering, roughness, scratches, dust, markers, albedo
    optics : Optics, projection, distortion, response curve, exposure, JPEG
    timing : Timing, frame rate, flicker, drift, dropped frames; only sequences use it
    shading : three tuples of 6 or 15 numbers, or None
        Gain over the image for each channel, for light guides and lenses that no LED position explains: the
        first number times `1 + a x + b y + c x^2 + d x y + e y^2` (or to the fourth degree), x and y in -1..1.
    cast_shadows : whether the surface shades itself; attached shadows are always there
    """

    leds: tuple[Led, ...]
    name: str = "simulated"
    shape: tuple[int, int] = (240, 320)
    mm_per_px: float = 0.0634
    ambient: Triple = (0, 0, 0)
    white_balance: Triple = (1, 1, 1)
    vignetting: float = 0.0
    crosstalk: tuple[Triple, Triple, Triple] = IDENTITY
    blur_px: float = 0.0
    noise_sd: float = 0.0
    noise_gain: float = 0.0
    relaxation_mm: float = 0.5
    gel: Gel = field(default_factory=Gel)
    coating: Coating = field(default_factory=Coating)
    optics: Optics = field(default_factory=Optics)
    timing: Timing = field(default_factory=Timing)
    shading: tuple[tuple[float, ...], ...] | None = None
    cast_shadows: bool = False

    def __post_init__(self) -> None:
        if len(self.shape) != 2 or any(int(n) != n or n < 2 for n in self.shape):
            raise ValueError(f"Expected shape as (H, W), at least 2x2, got {self.shape}.")
        check_mm_per_px(self.mm_per_px)
        check_positive(self.relaxation_mm, "relaxation_mm")
        if len(self.leds) == 0:
            raise ValueError("Expected at least one LED, got none.")
        for name in ("ambient", "white_balance", "crosstalk"):
            if np.min(np.asarray(getattr(self, name), dtype=np.float64)) < 0:
                raise ValueError(f"Expected {name} >= 0, got {getattr(self, name)}.")
        if np.shape(self.crosstalk) != (3, 3):
            raise ValueError(f"Expected crosstalk of shape (3, 3), got {np.shape(self.crosstalk)}.")
        check_not_negative(self, "blur_px", "noise_sd", "noise_gain")
        half_height, half_width = (n * self.mm_per_px / 2 for n in self.shape)
        for x, y, z in (led.position_mm for led in self.leds):
            # A light outside the gel may be at any height.
            if z < self.gel.thickness_mm and abs(x) < half_width and abs(y) < half_height:
                raise ValueError(
                    f"Expected every LED outside the gel, got one at {(x, y, z)} mm in a gel that is "
                    f"{self.gel.thickness_mm:g} mm thick: raise it, or move it beside the image."
                )
        if self.shading is not None and np.shape(self.shading) not in [(3, n) for n in SHADING_DEGREES]:
            raise ValueError(f"Expected shading as three tuples of 6 or 15 numbers, got {self.shading}.")
        check_fraction(self, "vignetting")

    def linear(self) -> SimulatedSensor:
        """The same sensor with gray levels in proportion to light: no response curve, no JPEG."""
        return replace(self, optics=replace(self.optics, response_gamma=1.0, jpeg_quality=None))

    def grid_mm(self, oversample: int = 1, margin: int = 0) -> tuple[Numbers, Numbers]:
        """Coordinates of (sub)pixel centers: x as a row (1, w), y as a column (h, 1), mm from the center.

        With an odd `oversample` the middle subpixel lies on the pixel's center. `margin` adds subpixels on each
        side.
        """
        pitch = self.mm_per_px / oversample
        height, width = (n * oversample + 2 * margin for n in self.shape)
        x = (np.arange(width) - (width - 1) / 2) * pitch
        y = (np.arange(height) - (height - 1) / 2) * pitch
        return np.asarray(x[None, :], dtype=np.float64), np.asarray(y[:, None], dtype=np.float64)


def settings_from_sensor(sensor: SimulatedSensor) -> dict[str, Any]:
    """A sensor as lists, numbers and words that JSON can hold; an albedo map as its values.

    `gelform.sensors.simulated.sensor_from_settings` is the inverse.
    """
    settings: dict[str, Any] = _plain(sensor)
    return settings


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return {one.name: _plain(getattr(value, one.name)) for one in fields(value)}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return np.asarray(getattr(value, "values", value)).tolist()
