"""The configuration of a LeRobot camera of type "gelform"."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.cameras import CameraConfig


@CameraConfig.register_subclass("gelform")
@dataclass(kw_only=True)
class GelformCameraConfig(CameraConfig):
    """A visual-tactile sensor with its calibration.

    Attributes
    ----------
    source : serial number, name, device path, address, recording, or "simulated"
    calibration : path of the sensor's calibration; "simulated" has its own
    use_rgb, use_depth : whether color and depth are observations; at least one of them
    fps : frames per second of a simulated sensor or a folder of images; cameras keep their own rate
    width, height : of the image after the calibration's view, px; None: from the calibration
    warn_lossy_rgb : whether to warn if LeRobot's default video encoder loses color, which slopes are read from
    """

    fps: int | None = 30
    source: str = "simulated"
    calibration: str = ""
    use_rgb: bool = True
    use_depth: bool = True
    warn_lossy_rgb: bool = True

    def __post_init__(self) -> None:
        if not (self.use_rgb or self.use_depth):
            raise ValueError("Expected use_rgb or use_depth to be true, both are false. Switch one on.")
        if not self.calibration and self.source != "simulated":
            raise ValueError(
                f"Expected the calibration of source {self.source!r}, got none. Make one with gelform calibrate and "
                "give its path as calibration."
            )
