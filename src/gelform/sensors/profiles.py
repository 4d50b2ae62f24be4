"""Sensors that are known by name: one table of their geometry, the order of their lights and their simulation.

To add a sensor, add a row to `SENSORS`. Importing this module loads no numpy: the help of the command line
lists the names in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log
from typing import TYPE_CHECKING

from gelform.errors import SensorError

if TYPE_CHECKING:
    from gelform.simulate.sensor.sensor import SimulatedSensor
    from gelform.view import View

MAX_ASPECT_ERROR = 0.01  # of pixels: 1 % out of square


@dataclass(frozen=True)
class SensorProfile:
    """The geometry of a kind of sensor, and the order of its lights.

    Attributes
    ----------
    name : as people write it; a sensor's own name starts with it
    image_shape : (H, W) of its images after the view
    border : fraction of the frame cut away on each of the four sides
    mm_per_px : mm per image pixel
    mm_per_px_sigma : its standard deviation between units and from what is known, mm
    verified : whether the scale was held against an independent measurement
    source : where these figures come from
    light_order : "clockwise" or "counter-clockwise": how red, green and blue light come round the gel in the
        image, measured on one unit. Turning the camera keeps it; reversed channels and mirrored images turn it.
    gel_thickness_mm : of its gel at rest, which no depth can exceed; None where no source says it
    """

    name: str
    image_shape: tuple[int, int]
    border: float
    mm_per_px: float
    mm_per_px_sigma: float
    verified: bool
    source: str
    light_order: str
    gel_thickness_mm: float | None = None

    def view(self, frame_shape: tuple[int, int]) -> View:
        """The view of frames (H, W) of this sensor, upright or turned by 90 degrees.

        A frame that already has the image's size counts as an image: nothing is cut from it.

        Raises
        ------
        SensorError
            The cropped frame has another aspect than the image: its pixels would not be square.
        """
        from gelform.view import View

        height, width = frame_shape
        image_shape = self.image_shape if self._is_upright(frame_shape) else self.image_shape[::-1]
        if frame_shape == image_shape:
            return View()
        aspect = (width / image_shape[1]) / (height / image_shape[0])
        if abs(aspect - 1) > MAX_ASPECT_ERROR:
            raise SensorError(
                f"Expected frames of a {self.name} with the aspect of {image_shape[0]}x{image_shape[1]} px "
                f"(height x width), got {height}x{width}. Choose another camera mode, or give a crop: "
                "a [view] in sensor.toml."
            )
        kept = 1 - 2 * self.border
        crop = (width * self.border, height * self.border, width * kept, height * kept)
        return View(frame_shape, crop if self.border else None, image_shape=image_shape)

    def _is_upright(self, frame_shape: tuple[int, int]) -> bool:
        return (frame_shape[0] <= frame_shape[1]) == (self.image_shape[0] <= self.image_shape[1])


@dataclass(frozen=True)
class KnownCamera:
    """The camera of a kind of sensor.

    Attributes
    ----------
    usb_id : vendor and product
    modes : ((height, width), frames a second) that it offers, the usual one first
    fourcc : the picture format that is asked for
    turn : what makes its frames upright, as a view says it: this make's images are taken turned
    led_levels : how many steps of LED brightness there are beside 0, set through the zoom control; 0: it cannot be set
    """

    usb_id: str
    modes: tuple[tuple[tuple[int, int], float], ...]
    fourcc: str
    led_levels: int = 0
    turn: str = "none"


@dataclass(frozen=True)
class KnownSensor:
    """A row of the table.

    Attributes
    ----------
    profile : SensorProfile, or None where there is no real sensor that it was taken from
    preset : the function of `gelform.simulate.presets` that makes its simulation; None where there is none
    camera : KnownCamera, or None where it is built with any camera
    """

    profile: SensorProfile | None
    preset: str | None = None
    camera: KnownCamera | None = None

    def simulated(self) -> SimulatedSensor:
        """The sensor to simulate; SensorError where there is no simulation of it."""
        from gelform.simulate import presets

        if self.preset is None:
            raise SensorError(
                "There is no simulation of this sensor. Take another one, or describe it in a TOML file."
            )
        sensor: SimulatedSensor = getattr(presets, self.preset)()
        return sensor


SENSORS = {
    "gelsight-mini": KnownSensor(
        SensorProfile(
            name="GelSight Mini",
            image_shape=(240, 320),
            border=1 / 7,
            mm_per_px=0.0634,
            mm_per_px_sigma=0.0009,
            verified=True,
            source="GelSight Inc., gsrobotics, examples for the Mini: 1/7 cut from each side, 0.0634 mm/px at "
            "240x320 (a later release cuts 0.15); an edge of 10 mm measured independently gave 0.0625 mm/px",
            light_order="clockwise",
        ),
        preset="gelsight_mini",
        camera=KnownCamera("0c45:636d", (((2464, 3280), 25.0),), "MJPG"),
    ),
    "digit": KnownSensor(
        SensorProfile(
            name="DIGIT",
            image_shape=(320, 240),
            border=0.0,
            mm_per_px=0.05107,
            mm_per_px_sigma=0.0037,
            verified=False,
            source="FOTS: 19.58 px/mm at 320x240 in its code, 21.09 in a comment beside it; not verified",
            light_order="counter-clockwise",
        ),
        preset="digit",
        camera=KnownCamera(
            "2833:0209",
            (((240, 320), 60.0), ((240, 320), 30.0), ((480, 640), 30.0), ((480, 640), 15.0)),
            "YUYV",
            led_levels=15,
            turn="left",
        ),
    ),
    "gelslim": KnownSensor(None, preset="gelslim"),
    "first-build": KnownSensor(None, preset="first_build"),
}
PROFILES = {name: known.profile for name, known in SENSORS.items() if known.profile is not None}


def profile_named(name: str) -> SensorProfile:
    """The profile of that name; SensorError, naming those that are known, where there is none."""
    if not isinstance(name, str) or name not in PROFILES:
        raise SensorError(
            f"Expected a sensor profile among {', '.join(PROFILES)}, got {name!r}. "
            "For another sensor give the scale (mm_per_px), or a folder with a sensor.toml."
        )
    return PROFILES[name]


def scale_off_make(sensor_name: str, image_shape: tuple[int, int], mm_per_px: float) -> float | None:
    """How far mm_per_px is from that of the make which a name starts with, |logarithm|, of images of its size (H, W).

    Of the profile's crop or of the whole frame, whichever is nearer; None for an unknown make or another size of images.
    """
    for profile in PROFILES.values():
        if sensor_name.startswith(profile.name) and tuple(image_shape) == profile.image_shape:
            usual = profile.mm_per_px, profile.mm_per_px / (1 - 2 * profile.border)
            return min(abs(log(mm_per_px / one)) for one in usual)
    return None


def light_order_of(sensor_name: str) -> str | None:
    """The order of the lights in the kind of sensor that a name starts with; None for an unknown kind."""
    orders = [p.light_order for p in PROFILES.values() if sensor_name.startswith(p.name)]
    return orders[0] if orders else None
