"""The source of frames: one interface to cameras, files, addresses and the simulated sensor."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isfinite
from numbers import Integral
from os import PathLike, sep
from types import TracebackType
from typing import Any, Protocol, cast

from gelform.errors import DataError, SensorError
from gelform.foundations.checks import check_path
from gelform.image.view import Frame
from gelform.sensors.cameras import UsbCamera, camera_named, check_settings, path_of_number
from gelform.sensors.containers import OF_DATA_SETS, is_data_set
from gelform.sensors.files import FILM_SUFFIXES
from gelform.sensors.films import is_film, open_film
from gelform.sensors.mjpeg import OPEN_S, MjpegUrl, shown_address
from gelform.sensors.playback import Playback
from gelform.sensors.simulated import RATE_HZ, SimulatedSource, simulated_sensor_named
from gelform.simulate import SimulatedSensor

SIMULATED, DEFAULT_SENSOR = "simulated", "three-edges"
ADDRESSES = ("http://", "https://")


class Source(Protocol):
    """Frames in sequence; a context manager.

    A loop over a live source raises SourceLostError if the source disappears or stalls. Each source is looped over once;
    `open_source` returns a new one.

    Attributes
    ----------
    name : for display, such as "GelSight Mini 2BKRXXXX", "simulated three-edges", "press.mp4"
    serial : the camera's serial number, if it has one
    settings : as read back: width, height, fps, exposure, gain, white_balance, led_level, as far as they exist
    live : True if frames arrive at their own time (a camera, an address, the simulated sensor, a paced replay); False if
        they are read as fast as possible
    rate_hz : nominal frames per second, if known
    """

    name: str
    serial: str | None
    settings: dict[str, float | str]
    live: bool
    rate_hz: float | None

    def __iter__(self) -> Iterator[Frame]: ...

    def close(self) -> None:
        """Release the device; a loop over the source, in any thread, ends at its next frame or timeout."""

    def __enter__(self) -> Source: ...

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None, /
    ) -> None: ...


def checked_frame(frame: Frame, after_index: int, name: str) -> Frame:
    """A frame of the source of that name; its number must be above `after_index`.

    SensorError: it is no frame, or its time or number is none. Readers would wait for ever, or read NaN.
    """
    image: Any = getattr(frame, "image", None)
    time_s: Any = getattr(frame, "time_s", None)
    if getattr(image, "ndim", 0) != 3 or image.shape[2] != 3:
        raise SensorError(f"Expected frames with an image (H, W, 3) from {name}, got {type(image).__name__}.")
    if not isinstance(time_s, (int, float)) or not isfinite(time_s):
        raise SensorError(f"Expected time_s in seconds in frame {frame.index} of {name}, got {time_s!r}.")
    if frame.index <= after_index:
        raise SensorError(
            f"Expected frames of {name} whose index grows, got {frame.index} after {after_index}."
        )
    return frame


def open_source(
    spec: str | PathLike[str] | int,
    *,
    paced: bool = False,
    rate_hz: float | None = None,
    timeout_s: float = OPEN_S,
    settings: Mapping[str, float | str] | None = None,
    bgr: bool = False,
    dataset: str = "",
) -> Source:
    """Open a camera, a file, a folder, a data set or the simulated sensor.

    Parameters
    ----------
    spec : the source

        - "simulated", or "simulated:NAME" for another simulated sensor than three-edges, such as gelsight-mini
        - http://... or https://...: a camera that sends JPEG pictures (multipart/x-mixed-replace)
        - the serial number of a USB camera, its name (or three letters of it, or "digit", "gelsight-mini"), its path,
          or its number (0, 1, ... or the text), as in /dev/video0; "" for the only connected camera
        - *.mcap, a rosbag2 folder, a video file, a folder of images, a TIFF of several pages, or frames of numpy (*.npy)
        - an HDF5 file, a Zarr store or a LeRobot data set (version 3.0), whose films come one after the other
    paced : whether files play at their original pace, instead of as fast as they can be read
    rate_hz : frames per second of the simulated sensor (60), of a folder of images, and of HDF5 and Zarr (25)
    timeout_s : timeout of the connection to an address, s
    settings : values to set on a USB camera: width, height, fps, fourcc, exposure, gain, white_balance, led_level; they are
        read back. The simulated sensor and a folder of images take fps, as `rate_hz`; other sources none
    bgr : whether the frames are blue, green, red, as OpenCV writes an array
    dataset : the datasets of HDF5 or Zarr, or cameras of LeRobot; * matches one name ("data/*/obs/gelsight"); a name of an
        episode may follow ("observation.images.gel/episode_000003"). Not needed where there is one

    Returns
    -------
    Source
        A context manager; a loop over it gives `Frame`s, RGB.

    Raises
    ------
    SensorError
        No camera or several match (the message lists the connected ones); access is denied (with the udev rule); the camera
        is in use or rejects a setting; or the source has no such setting.
    DataError
        The file or folder is missing or cannot be read.
    """
    spec = spec_of(spec)
    if not isinstance(spec, (str, PathLike)):
        raise TypeError(f"Expected a source as text, a path or a camera's number, got {type(spec).__name__}.")
    settings = check_settings(settings or {})
    fps = settings.get("fps")
    opened: Any = _without_settings(spec, paced, rate_hz or cast("float | None", fps), timeout_s, dataset)
    if opened is None:
        opened = UsbCamera(camera_named(str(spec)), settings)
    elif refused := [name for name in settings if name != "fps" or opened.rate_hz != fps]:
        opened.close()
        raise SensorError(
            f"{shown_address(str(spec))} is no USB camera: {', '.join(refused)} cannot be set. Leave it out. A simulated "
            "sensor and a folder of images take fps alone."
        )
    opened.bgr = bgr
    return cast("Source", opened)


def spec_of(source: Any) -> Any:
    """The path of the camera whose number the source is; anything else unchanged.

    SensorError: no camera has a number below 0.
    """
    if isinstance(source, bool) or not isinstance(source, Integral):
        return source
    if source < 0:
        raise SensorError(f"Expected the number of a camera, 0 or more, got {source}.")
    return path_of_number(str(int(source)))


def _without_settings(
    spec: str | PathLike[str], paced: bool, rate_hz: float | None, timeout_s: float, dataset: str
) -> Source | None:
    """The simulated sensor, an address, or a film; None if the spec can only be a USB camera's."""
    if dataset and not is_film(str(spec)):
        raise DataError(f"{OF_DATA_SETS} ({dataset}); got {shown_address(str(spec))}. Leave it out.")
    if isinstance(spec, str) and spec.startswith(ADDRESSES):
        return MjpegUrl(spec, timeout_s=timeout_s)
    try:
        sensor = simulated_sensor_of(spec) if isinstance(spec, str) else None
    except ValueError as problem:
        raise SensorError(f'{spec!r}: {problem} "simulated" alone is {DEFAULT_SENSOR}.') from problem
    if sensor is not None:
        return SimulatedSource(sensor, rate_hz=rate_hz or RATE_HZ)
    if isinstance(spec, str) and "://" in spec:
        raise SensorError(
            f"Expected an address that begins with {' or '.join(ADDRESSES)} (a camera that sends JPEG pictures), a USB "
            f"camera, a video, a folder or a recording, got {shown_address(spec)}. Record it as a file first, such as with "
            "ffmpeg -i ADDRESS -c copy press.mkv; its compression costs accuracy."
        )
    if not str(spec):
        return None
    path = check_path(spec, "a source")
    if is_film(str(path)) or path.suffix.lower() in FILM_SUFFIXES or is_data_set(path):
        film = open_film(path, rate_hz=rate_hz, dataset=dataset)
        return Playback(film, film.camera, paced=paced)
    if {"/", sep} & set(str(spec)) and not str(spec).startswith("/dev/"):  # "seq/" too
        raise DataError(f"No file or folder {spec}. Check the path.")
    return None


def simulated_sensor_of(spec: str) -> SimulatedSensor | None:
    """The simulated sensor that a spec names, "simulated" or "simulated:NAME"; None for any other source.

    ValueError: there is no such sensor; the message lists them.
    """
    kind, _, name = spec.partition(":")
    return simulated_sensor_named(name or DEFAULT_SENSOR) if kind == SIMULATED else None


def device_of(spec: str) -> str:
    """What tells a device from others: the path of the camera that a spec means; addresses and unknown names unchanged."""
    if spec.startswith(ADDRESSES):
        return spec
    try:
        return camera_named(spec).path
    except SensorError:
        return spec
