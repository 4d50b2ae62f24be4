"""A visual-tactile sensor as a LeRobot camera: the newest image and its depth."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from lerobot.cameras import Camera
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected
from numpy.typing import NDArray

import gelform
from gelform.robots import lerobot_levels_from_depth
from gelform.sensors import cameras_there, open_source
from lerobot_camera_gelform.config_gelform import GelformCameraConfig
from lerobot_camera_gelform.encoders import warn_if_lossy

READ_MS, FIRST_MS = 10_000.0, 15_000.0
COLOR, DEPTH, FORCE = "color", "depth", "force"


class GelformCamera(Camera):
    """The newest image of a sensor and its depth, uint16 = 1000 + depth in um (LeRobot's "mm" then means um).

    Parameters
    ----------
    config : GelformCameraConfig

    Raises
    ------
    gelform.GelformError
        The calibration cannot be read, or has no scale, which depth in um needs.
    ValueError
        The configured width and height differ from the calibrated image's.
    """

    def __init__(self, config: GelformCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self.use_rgb, self.use_depth = config.use_rgb, config.use_depth
        self.calibration = _calibration(config)
        if config.use_depth:
            _ = self.calibration.known_mm_per_px
        shape = self.calibration.image_shape
        asked = (config.height or shape[0], config.width or shape[1])
        if asked != shape:
            raise ValueError(
                f"Expected height {shape[0]} and width {shape[1]}, those of the calibrated image, got {asked[0]} and "
                f"{asked[1]}. Leave them out."
            )
        self.height, self.width = shape
        self._stream: gelform.Stream | None = None
        self._consumed = {COLOR: -1, DEPTH: -1}

    def __str__(self) -> str:
        return f"GelformCamera({self.config.source})"

    @property
    def is_connected(self) -> bool:
        """Whether the sensor is open."""
        return self._stream is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """The available sources: cameras by serial number or path, known sensors by name, the simulated sensor last."""
        found = [
            {
                "name": one.name,
                "type": "gelform",
                "id": one.serial or one.path,
                "path": one.path,
                "sensor": one.kind,
            }
            for one in cameras_there()
        ]
        return [*found, {"name": "simulated sensor", "type": "gelform", "id": "simulated"}]

    @check_if_already_connected
    def connect(self, warmup: bool = True) -> None:
        """Open the sensor and start to reconstruct.

        Parameters
        ----------
        warmup : whether to wait for the first depth

        Raises
        ------
        ConnectionError
            The sensor cannot be opened, or gives no frame.
        """
        if self.use_rgb and self.config.warn_lossy_rgb:
            warn_if_lossy()
        try:
            self._stream = gelform.stream(self._opened, self.calibration)
            self._consumed = {COLOR: -1, DEPTH: -1}
            if warmup:
                self._newest(-1, FIRST_MS)
        except (gelform.GelformError, ValueError, TimeoutError) as problem:
            if self._stream is not None:
                self.disconnect()
            raise ConnectionError(f"{self}: {problem}") from problem

    def disconnect(self) -> None:
        """Release the sensor."""
        stream = self._running()
        self._stream = None
        stream.close()

    # -- color -------------------------------------------------------------------------------------------------------

    def read(self) -> NDArray[np.uint8]:
        """Wait for the next image (H, W, 3), RGB, after the calibration's view."""
        return self._read(COLOR).image

    def async_read(self, timeout_ms: float = 200) -> NDArray[np.uint8]:
        """The newest image that was not returned yet; waits for one, and raises TimeoutError if none arrives in time."""
        return self._unconsumed(COLOR, timeout_ms).image

    def read_latest(self, max_age_ms: int = 500) -> NDArray[np.uint8]:
        """The newest image, at once; TimeoutError if it is too old, RuntimeError before the first one."""
        return self._latest(COLOR, max_age_ms).image

    # -- depth --------------------------------------------------------------------------------------------------------

    def read_depth(self) -> NDArray[np.uint16]:
        """Wait for the next depth (H, W, 1), 1000 + um."""
        return _levels(self._read(DEPTH))

    def async_read_depth(self, timeout_ms: float = 200) -> NDArray[np.uint16]:
        """The newest depth that was not returned yet; waits for one, and raises TimeoutError if none arrives in time."""
        return _levels(self._unconsumed(DEPTH, timeout_ms))

    def read_latest_depth(self, max_age_ms: int = 500) -> NDArray[np.uint16]:
        """The newest depth, at once; TimeoutError if it is too old, RuntimeError before the first one."""
        return _levels(self._latest(DEPTH, max_age_ms))

    # -- force --------------------------------------------------------------------------------------------------------

    def read_latest_force(self, max_age_ms: int = 500) -> NDArray[np.float32]:
        """The newest force on the gel (3,), N, at once; NaN where it is not known, of which the result has the reason.

        What presses into the gel pushes toward the camera, which is -z. TimeoutError if it is too old, RuntimeError before
        the first one, or if no loads were calibrated.
        """
        if self.calibration.force is None:
            raise RuntimeError(
                f"Expected a calibration of {self} with loads (gelform force calibrate), got none."
            )
        return self._latest(FORCE, max_age_ms).result.force.vector_n.astype(np.float32)

    # -- results ------------------------------------------------------------------------------------------------------

    def _read(self, what: str) -> Any:
        self._check_used(what)
        now = self._running().newest(-1, 0.0)
        return self._given(what, self._newest(-1 if now is None else now.index, READ_MS))

    def _unconsumed(self, what: str, timeout_ms: float) -> Any:
        self._check_used(what)
        return self._given(what, self._newest(self._consumed[what], timeout_ms))

    def _latest(self, what: str, max_age_ms: float) -> Any:
        self._check_used(what)
        seen = self._running().newest(-1, 0.0)
        if seen is None:
            raise RuntimeError(f"{self} has given nothing yet. Connect with warmup, or wait.")
        age_ms = 1e3 * (time.monotonic() - seen.time_s)
        if age_ms > max_age_ms:
            raise TimeoutError(
                f"Expected {what} at most {max_age_ms} ms old, got {age_ms:.0f} ms. {self._state()}"
            )
        return self._given(what, seen)

    def _given(self, what: str, seen: Any) -> Any:
        self._consumed[what] = seen.index
        return seen

    def _check_used(self, what: str) -> None:
        used, name = (self.use_rgb, "use_rgb") if what == COLOR else (self.use_depth, "use_depth")
        if not used and what != FORCE:
            raise RuntimeError(
                f"Expected {name}=True in the configuration of {self} to read {what}, got False."
            )

    def _newest(self, after: int, timeout_ms: float) -> Any:
        seen = self._running().newest(after, timeout_ms / 1e3)
        if seen is None:
            raise TimeoutError(
                f"Expected a frame of {self} within {timeout_ms:g} ms, none came. {self._state()}"
            )
        return seen

    @check_if_not_connected
    def _running(self) -> gelform.Stream:
        assert self._stream is not None
        return self._stream

    def _state(self) -> str:
        stats = self._running().stats
        return f"The sensor is {stats.state}{f': {stats.reason}' if stats.reason else ''}."

    def _opened(self) -> Any:
        return open_source(self.config.source, paced=True, rate_hz=self.fps)


def _levels(seen: Any) -> NDArray[np.uint16]:
    return lerobot_levels_from_depth(seen.result.depth_mm)[..., None]


def _calibration(config: GelformCameraConfig) -> gelform.Calibration:
    if config.calibration:
        return gelform.load_calibration(config.calibration)
    from gelform.calibration.library import ready_calibration
    from gelform.sensors.simulated import simulated_sensor_named
    from gelform.sensors.source import DEFAULT_SENSOR

    return ready_calibration(simulated_sensor_named(DEFAULT_SENSOR))
