"""The table of known sensors: geometry, order of the lights and simulation.

To add a sensor, add a row to `SENSORS`. This module does not import numpy, because the command line's help lists these
names.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log
from typing import TYPE_CHECKING

from gelform.errors import SensorError

if TYPE_CHECKING:
    from gelform.image.view import View
    from gelform.simulate.sensor import SimulatedSensor


# mm, widths of sensors' gels: usual ones, and the limits of what is believed. Of a known make half to twice is believed:
# units and crops differ by less.
USUAL_GEL_MM, GEL_MM, MAKE_FACTOR = (5.0, 60.0), (3.0, 150.0), 2.0
SAME_SCALE = 0.1  # |logarithm| of mm_per_px over the make's: units of a make differ by under 7 %


@dataclass(frozen=True)
class SensorProfile:
    """The geometry of a make of sensor, and the order of its lights."""

    name: str  # the usual one; names of single sensors start with it
    image_shape: tuple[int, int]  # (H, W) of its images after the view
    border: float  # fraction of the frame that is cropped on each of the four sides
    mm_per_px: float  # of images
    mm_per_px_sigma: float  # its standard deviation: variation between units and uncertainty of the source
    source: str  # origin of these figures
    # "clockwise" or "counter-clockwise": the order of red, green and blue light around the gel in the image, measured on one
    # unit. Turning the camera keeps it; swapping channels or mirroring the image reverses it.
    light_order: str
    gel_thickness_mm: float | None = None  # of its gel at rest, the upper limit of depth; None if not stated

    def view(self, frame_shape: tuple[int, int]) -> View:
        """The view of frames (H, W) of this sensor, upright or turned by 90 degrees.

        A frame that already has the image's size counts as an image and is not cropped.

        SensorError: the cropped frame has another aspect ratio than the image, whose pixels would not be square.
        """
        from gelform.image.view import View

        height, width = frame_shape
        image_shape = self._shape_like(frame_shape)
        if frame_shape == image_shape:
            return View()
        if not self.has_aspect(frame_shape):
            raise SensorError(
                f"Expected frames of a {self.name} with the aspect of {image_shape[0]}x{image_shape[1]} px "
                f"(height x width), got {height}x{width}. Choose another camera mode, or give a crop: "
                "a [view] in sensor.toml."
            )
        kept = 1 - 2 * self.border
        crop = (width * self.border, height * self.border, width * kept, height * kept)
        return View(frame_shape, crop if self.border else None, image_shape=image_shape)

    def has_aspect(self, frame_shape: tuple[int, int]) -> bool:
        """Whether frames (H, W) have the aspect of its images, upright or turned by 90 degrees."""
        rows, columns = self._shape_like(frame_shape)
        return abs((frame_shape[1] / columns) / (frame_shape[0] / rows) - 1) <= 0.01

    def scale_off(self, mm_per_px: float) -> tuple[float, float]:
        """Distance |log ratio| of a scale from that of its images, and the border that they are cropped by.

        The nearer of two scales counts: that of the usual crop and that of the whole frame.
        """
        kept = 1 - 2 * self.border
        usual = ((self.mm_per_px, self.border), (self.mm_per_px / kept, 0.0))
        return min((abs(log(mm_per_px / one)), border) for one, border in usual)

    def is_cropped_scale(self, mm_per_px: float | None) -> bool:
        """Whether a scale is that of its images after the usual crop."""
        return mm_per_px is not None and abs(log(mm_per_px / self.mm_per_px)) < SAME_SCALE

    def _shape_like(self, frame_shape: tuple[int, int]) -> tuple[int, int]:
        """(H, W) of its images, lying as frames (H, W) do."""
        upright = (frame_shape[0] <= frame_shape[1]) == (self.image_shape[0] <= self.image_shape[1])
        return self.image_shape if upright else (self.image_shape[1], self.image_shape[0])


@dataclass(frozen=True)
class KnownCamera:
    """The camera of a make of sensor."""

    usb_id: str  # vendor and product
    frame_shape: tuple[int, int]  # (height, width) of its usual mode
    rate_hz: float  # frames per second of that mode
    fourcc: str  # the picture format to request
    led_levels: int = 0  # LED brightness steps above 0, set through the zoom control; 0 if they cannot be set
    turn: str = "none"  # rotation that makes its frames upright, as in a view

    def turned(self, view: View, frame_shape: tuple[int, int], image_shape: tuple[int, int]) -> View | None:
        """A view of its frames (H, W) whose images are (H, W), turned as the camera lies; None if there is none."""
        shape = view.shape or frame_shape
        if shape == image_shape:
            return view
        if self.turn == "none" or shape != image_shape[::-1]:
            return None
        return replace(view, frame_shape=frame_shape, turn=self.turn, image_shape=image_shape)


@dataclass(frozen=True)
class KnownSensor:
    """A row of the table."""

    profile: SensorProfile | None  # None if no real sensor exists
    preset: str | None = None  # function of `gelform.simulate.presets` that makes its simulation, if any does
    camera: KnownCamera | None = None  # None if units are built with any camera

    def simulated(self) -> SimulatedSensor:
        """The sensor to simulate; SensorError if it has no simulation."""
        from gelform.simulate import presets

        if self.preset is None:
            raise SensorError(
                "There is no simulation of this sensor. Take another one, or describe it in a TOML file."
            )
        sensor: SimulatedSensor = getattr(presets, self.preset)()
        return sensor


# Each figure is from the source that stands beside it.
SENSORS = {
    "gelsight-mini": KnownSensor(
        SensorProfile(
            name="GelSight Mini",
            image_shape=(240, 320),
            border=1 / 7,
            mm_per_px=0.0634,
            mm_per_px_sigma=0.0009,
            source="GelSight Inc., gsrobotics, examples for the Mini: 1/7 cut from each side, 0.0634 mm/px at "
            "240x320 (a later release cuts 0.15); an edge of 10 mm measured independently gave 0.0625 mm/px",
            light_order="clockwise",
        ),
        preset="gelsight_mini",
        camera=KnownCamera("0c45:636d", (2464, 3280), 25.0, "MJPG"),
    ),
    "digit": KnownSensor(
        SensorProfile(
            name="DIGIT",
            image_shape=(320, 240),
            border=0.0,
            mm_per_px=0.05107,
            mm_per_px_sigma=0.0037,
            source="FOTS: 19.58 px/mm at 320x240 in its code, 21.09 in a comment beside it; not verified",
            light_order="counter-clockwise",
        ),
        preset="digit",
        camera=KnownCamera("2833:0209", (240, 320), 60.0, "YUYV", led_levels=15, turn="left"),
    ),
    "gelslim": KnownSensor(None, preset="gelslim"),
    "first-build": KnownSensor(None, preset="first_build"),
}
PROFILES = {name: known.profile for name, known in SENSORS.items() if known.profile is not None}


def profile_named(name: str) -> SensorProfile:
    """The profile with that name; SensorError if there is none, with the known names."""
    if not isinstance(name, str) or name not in PROFILES:
        raise SensorError(
            f"Expected a sensor profile among {', '.join(PROFILES)}, got {name!r}. "
            "For another sensor give the scale (mm_per_px), or a folder with a sensor.toml."
        )
    return PROFILES[name]


def make_of(sensor_name: str) -> str | None:
    """The make that a sensor's name starts with; None for an unknown make."""
    return next((name for name, one in PROFILES.items() if sensor_name.startswith(one.name)), None)


def scale_off_make(make: str | None, image_shape: tuple[int, int], mm_per_px: float) -> float | None:
    """Distance |log ratio| of mm_per_px from the scale of a make's images (H, W), as `SensorProfile.scale_off` has it.

    None for an unknown make or for another image size.
    """
    profile = PROFILES.get(make or "")
    if profile is None or tuple(image_shape) != profile.image_shape:
        return None
    return profile.scale_off(mm_per_px)[0]


def check_gel_width(image_shape: tuple[int, int], mm_per_px: float, make: str | None = None) -> str | None:
    """Refuse a scale, mm/px, with which the gel in images (H, W) would have a width that no sensor has: ValueError.

    A known make's gel is half to twice as wide as stated; another one 3 to 150 mm. Returns a note if an unknown one is
    narrower than 5 mm or wider than 60 mm, else None.
    """
    profile, width = PROFILES.get(make or ""), max(image_shape)
    low, high = GEL_MM
    if profile is not None:
        width_mm = max(profile.image_shape) * profile.mm_per_px
        low, high = width_mm / MAKE_FACTOR, MAKE_FACTOR * width_mm
    of = "a gel" if profile is None else f"the gel of a {profile.name}"
    got = f"{width} px of {mm_per_px:g} mm: {width * mm_per_px:.3g} mm"
    remedy = (
        "A scale belongs to images of one size. Crop and resize these to that size, or give their own mm_per_px; gelform "
        "scale measures it."
    )
    if not low <= width * mm_per_px <= high:
        raise ValueError(f"Expected {of} between {low:.3g} and {high:.3g} mm wide, got {got}. {remedy}")
    if profile is None and not USUAL_GEL_MM[0] <= width * mm_per_px <= USUAL_GEL_MM[1]:
        usual = "{:g} to {:g} mm".format(*USUAL_GEL_MM)
        return f"Gels of sensors are {usual} wide; this one would be {got}. {remedy}"
    return None


def view_from_camera(make: str | None, image_shape: tuple[int, int], mm_per_px: float | None) -> View:
    """The view from the frames of a make's camera to images (H, W) of a scale; identity if they are not the make's."""
    from gelform.image.view import View

    known = SENSORS.get(make or "")
    if known is None or known.profile is None or known.camera is None or mm_per_px is None:
        return View()
    off, border = known.profile.scale_off(mm_per_px)
    if off >= SAME_SCALE:
        return View()
    frame_shape = known.camera.frame_shape
    view = replace(known.profile, border=border).view(frame_shape)
    return known.camera.turned(view, frame_shape, image_shape) or View()


def light_order_of(make: str | None) -> str | None:
    """The order of the lights of a make; None for an unknown one."""
    return None if make is None else PROFILES[make].light_order
