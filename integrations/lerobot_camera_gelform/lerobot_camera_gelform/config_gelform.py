"""What a camera of LeRobot of type "gelform" is set to."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.cameras import CameraConfig


@CameraConfig.register_subclass("gelform")
@dataclass(kw_only=True)
class GelformCameraConfig(CameraConfig):
    """A visual-tactile sensor through its calibration.

    Attributes
    ----------
    source : serial, name, device path, address, recording, or "simulated"
    calibration : path of the sensor's calibration; "simulated" has one of its own
    use_rgb, use_depth : whether colour and depth are observations; one of them at least
    fps : frames a second that a simulated sensor or a folder of images gives; cameras keep their own rate
    width, height : of the image after the calibration's view, px; taken from the calibration where None
    warn_lossy_rgb : whether to warn where LeRobot's default video encoder would lose colour that slopes are read from
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
