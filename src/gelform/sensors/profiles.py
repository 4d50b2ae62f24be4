"""What is known of sensors that many people have: where the gel is in a frame, and how large a pixel is."""

from __future__ import annotations

from dataclasses import dataclass

from gelform.errors import SensorError
from gelform.view import View

MAX_ASPECT_ERROR = 0.01


@dataclass(frozen=True)
class SensorProfile:
    """A kind of sensor.

    Attributes
    ----------
    name : str
    image_shape : (H, W) of its images after the view
    border : fraction of the frame cut away on each of the four sides
    mm_per_px : mm per image pixel
    mm_per_px_sigma : its standard deviation between units and from what is known, mm
    verified : whether the scale was held against an independent measurement
    source : where these figures come from
    """

    name: str
    image_shape: tuple[int, int]
    border: float
    mm_per_px: float
    mm_per_px_sigma: float
    verified: bool
    source: str

    def view(self, frame_shape: tuple[int, int]) -> View:
        """The view of frames (H, W) of this sensor, upright or turned by 90 degrees.

        A frame that already has the image's size counts as an image: nothing is cut from it.

        Raises
        ------
        SensorError
            The cropped frame has another aspect than the image: its pixels would not be square.
        """
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


PROFILES = {
    "gelsight-mini": SensorProfile(
        name="GelSight Mini",
        image_shape=(240, 320),
        border=1 / 7,
        mm_per_px=0.0634,
        mm_per_px_sigma=0.0009,
        verified=True,
        source="GelSight Inc., gsrobotics, examples for the Mini: 1/7 cut from each side, 0.0634 mm/px at "
        "240x320 (a later release cuts 0.15); an edge of 10 mm measured independently gave 0.0625 mm/px",
    ),
    "digit": SensorProfile(
        name="DIGIT",
        image_shape=(320, 240),
        border=0.0,
        mm_per_px=0.05107,
        mm_per_px_sigma=0.0037,
        verified=False,
        source="FOTS: 19.58 px/mm at 320x240 in its code, 21.09 in a comment beside it; not verified",
    ),
}


def profile_named(name: str) -> SensorProfile:
    """The profile of that name; SensorError, naming those that are known, where there is none."""
    if name not in PROFILES:
        raise SensorError(
            f"Expected a sensor profile among {', '.join(PROFILES)}, got {name!r}. "
            "For another sensor give the scale (mm_per_px), or a folder with a sensor.toml."
        )
    return PROFILES[name]
