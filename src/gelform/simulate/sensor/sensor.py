"""What a simulated sensor is: its grid, lights, optics, noise and gel, as plain numbers."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.checks import check_mm_per_px, check_positive
from gelform.simulate.gel.gel import Gel
from gelform.simulate.sensor.coating import Coating
from gelform.simulate.sensor.led import Led, Triple
from gelform.simulate.sensor.optics import Optics
from gelform.simulate.sensor.timing import Timing

SHADING_DEGREES = {6: 2, 15: 4}  # numbers of a polynomial in two variables: its degree
IDENTITY: tuple[Triple, Triple, Triple] = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


@dataclass(frozen=True)
class SimulatedSensor:
    """A sensor that exists as numbers; `LAYOUTS` holds ready ones.

    Attributes
    ----------
    leds : tuple of Led
    name : str
    shape : (H, W)
        Pixels of the image.
    mm_per_px : float
        Pixel pitch on the gel, mm.
    ambient : (red, green, blue)
        Grey levels of light from all sides (scattered in the gel), before vignetting.
    white_balance : (red, green, blue)
        Gain of each channel behind the crosstalk; `exposed` finds it.
    vignetting : float, 0-1
        Part of the light lost in the image's corners, growing with the square of the distance to the centre.
    crosstalk : 3x3, >= 0
        Row c: how much of the red, green, blue light channel c sees.
    blur_px : float
        Standard deviation of the optics' blur.
    noise_sd : float
        Read noise, grey levels.
    noise_gain : float
        Shot noise: variance per grey level of signal.
    relaxation_mm : float
        Length over which the gel's surface relaxes beside the contact.
    gel : Gel
        Thickness, bulge, friction.
    coating : Coating
        What the gel's surface looks like: gloss, scattering, roughness, scratches, dust, markers, albedo.
    optics : Optics
        Projection, distortion, response curve, exposure, JPEG.
    timing : Timing
        Frame rate, flicker, drift, dropped frames; only sequences know it.
    shading : three tuples of 6 or 15 numbers, or None
        Per channel the gain over the image, for light guides and lenses that no LED position explains: the
        first number times `1 + a x + b y + c x^2 + d x y + e y^2` (or to the fourth degree), x and y in -1..1.
    cast_shadows : bool
        Whether the surface shades itself; attached shadows are always there.
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
        _check_shape(self.shape)
        check_mm_per_px(self.mm_per_px)
        check_positive(self.relaxation_mm, "relaxation_mm")
        if len(self.leds) == 0:
            raise ValueError("Expected at least one LED, got none.")
        for name in ("ambient", "white_balance", "crosstalk"):
            if np.min(np.asarray(getattr(self, name), dtype=np.float64)) < 0:
                raise ValueError(f"Expected {name} >= 0, got {getattr(self, name)}.")
        if np.shape(self.crosstalk) != (3, 3):
            raise ValueError(f"Expected crosstalk of shape (3, 3), got {np.shape(self.crosstalk)}.")
        for name in ("blur_px", "noise_sd", "noise_gain"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"Expected {name} >= 0, got {getattr(self, name)}.")
        for led in self.leds:
            _check_outside_gel(led, self)
        if self.shading is not None and np.shape(self.shading) not in [(3, n) for n in SHADING_DEGREES]:
            raise ValueError(f"Expected shading as three tuples of 6 or 15 numbers, got {self.shading}.")
        if not 0 <= self.vignetting < 1:
            raise ValueError(f"Expected vignetting in 0-1 (1 excluded), got {self.vignetting}.")

    def linear(self) -> SimulatedSensor:
        """The same sensor with grey levels in proportion to light: no response curve, no JPEG."""
        return replace(self, optics=replace(self.optics, response_gamma=1.0, jpeg_quality=None))

    def grid_mm(
        self, oversample: int = 1, margin: int = 0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Coordinates of (sub)pixel centres: x as a row (1, w), y as a column (h, 1), mm from the centre.

        With an odd `oversample` the middle subpixel lies on the pixel's centre. `margin` adds subpixels on each
        side.
        """
        pitch = self.mm_per_px / oversample
        height, width = (n * oversample + 2 * margin for n in self.shape)
        x = (np.arange(width) - (width - 1) / 2) * pitch
        y = (np.arange(height) - (height - 1) / 2) * pitch
        return np.asarray(x[None, :], dtype=np.float64), np.asarray(y[:, None], dtype=np.float64)

    def px_from_mm(self, center_mm: tuple[float, float]) -> tuple[float, float]:
        """Pixel coordinates (x, y) of a point given in mm from the gel's centre."""
        height, width = self.shape
        x, y = center_mm
        return x / self.mm_per_px + (width - 1) / 2, y / self.mm_per_px + (height - 1) / 2


def settings_from_sensor(sensor: SimulatedSensor) -> dict[str, Any]:
    """A sensor as lists, numbers and words that JSON can hold; an albedo map as its values.

    `gelform.sensors.simulated.settings.sensor_from_settings` turns them back into the sensor.
    """
    return {one.name: _plain(getattr(sensor, one.name)) for one in fields(sensor)}


def _check_outside_gel(led: Led, sensor: SimulatedSensor) -> None:
    """Refuse a light between the gel's two faces; one beside the gel may be as low as it likes."""
    x, y, z = led.position_mm
    half_height, half_width = (n * sensor.mm_per_px / 2 for n in sensor.shape)
    if z < sensor.gel.thickness_mm and abs(x) < half_width and abs(y) < half_height:
        raise ValueError(
            f"Expected every LED outside the gel, got one at {led.position_mm} mm in a gel that is "
            f"{sensor.gel.thickness_mm:g} mm thick: raise it, or move it beside the image."
        )


def _check_shape(shape: tuple[int, int]) -> None:
    if len(shape) != 2 or any(int(n) != n or n < 2 for n in shape):
        raise ValueError(f"Expected shape as (H, W), at least 2x2, got {shape}.")


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return {one.name: _plain(getattr(value, one.name)) for one in fields(value)}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return np.asarray(getattr(value, "values", value)).tolist()
