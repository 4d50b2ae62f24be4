"""The simulated sensor as a source of frames, and simulated sensors by name, from settings or from a TOML file."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from gelform import simulate
from gelform.arrays import Array, Image
from gelform.errors import SensorError
from gelform.foundations.checks import check_positive
from gelform.image.view import Frame
from gelform.sensors.files import read_toml
from gelform.sensors.playback import Closing, FrameReader, Pace
from gelform.sensors.profiles import SENSORS
from gelform.simulate import LAYOUTS, Ball, Indenter, Led, Pose, SimulatedSensor
from gelform.simulate.light import image_from_levels

SECTIONS = {
    "gel": simulate.Gel,
    "coating": simulate.Coating,
    "optics": simulate.Optics,
    "timing": simulate.Timing,
}
OWN_KEYS = ("base", "exposed_levels")
LED_KEYS = ("peak_nm", "width_nm", "power")
KINDS: Any = (("true or false", bool), ("a number", (int, float)), ("text", str), ("a list", (list, tuple)))


def simulated_sensor_named(name: str) -> SimulatedSensor:
    """A ready-made sensor: a layout of lights, or a known sensor. For an unknown name the error suggests the nearest one."""
    known = _ready_names()
    if name not in known:
        raise ValueError(f"Expected a sensor among {', '.join(known)}, got {name!r}.{_nearest(name, known)}")
    return LAYOUTS[name] if name in LAYOUTS else SENSORS[name].simulated()


def read_simulated_sensor(path: str | PathLike[str]) -> SimulatedSensor:
    """Read a simulated sensor from a TOML file; see `sensor_from_settings` for its keys.

    Raises
    ------
    SensorError
        The file is missing or no TOML, has unknown or misspelled keys (the nearest is suggested), or values out of range.
    """
    settings = read_toml(Path(path), "a simulated sensor as TOML", SensorError)
    try:
        return sensor_from_settings(settings)
    except (ValueError, TypeError) as problem:
        raise SensorError(f"{path}: {problem}") from problem


def sensor_from_settings(settings: Mapping[str, Any]) -> SimulatedSensor:
    """Make a sensor from settings.

    Parameters
    ----------
    settings : mapping
        `base` (a ready-made sensor to start from; without it `leds` is required), the fields of `SimulatedSensor`, `leds` as
        a list of tables with the fields of `Led` (`peak_nm`, `width_nm` and `power` may replace `color`), the tables `gel`,
        `coating`, `optics`, `timing`, and `exposed_levels`, the desired mean level per channel.

    Raises
    ------
    ValueError, TypeError
        A key is unknown (the nearest known one is suggested), or a value has the wrong type or is out of range.
    """
    _check(settings, SimulatedSensor, "the sensor", OWN_KEYS)
    taken = (*OWN_KEYS, *SECTIONS, "leds")
    given = {key: _frozen(value) for key, value in settings.items() if key not in taken}
    if "leds" in settings:
        leds = settings["leds"]
        if not isinstance(leds, Sequence) or not all(isinstance(led, Mapping) for led in leds):
            raise TypeError(f"Expected leds as tables, [[leds]], got {leds!r}.")
        given["leds"] = tuple(map(_led, leds))
    base = simulated_sensor_named(str(settings["base"])) if "base" in settings else None
    if base is None and "leds" not in given:
        raise ValueError(
            f"Expected base (one of {', '.join(_ready_names())}) or a list of [[leds]], got neither."
        )
    for name, kind in SECTIONS.items():
        if name in settings:
            given[name] = _section(name, kind, settings[name], base)
    sensor = SimulatedSensor(**given) if base is None else replace(base, **given)
    levels = _frozen(settings.get("exposed_levels"))
    return simulate.exposed(sensor, levels) if "exposed_levels" in settings else sensor


def _section(name: str, kind: Any, table: Any, base: SimulatedSensor | None) -> Any:
    if not isinstance(table, Mapping):
        raise TypeError(f"Expected [{name}] as a table, got {table!r}.")
    _check(table, kind, f"[{name}]")
    values = {
        key: np.asarray(value) if key == "albedo" and value is not None else _frozen(value)
        for key, value in table.items()
    }
    start = kind() if base is None else getattr(base, name)
    return replace(start, **values)


def _led(table: Mapping[str, Any]) -> Led:
    _check(table, Led, "[[leds]]", LED_KEYS)
    values = {key: _frozen(value) for key, value in table.items() if key not in LED_KEYS}
    if "position_mm" not in values:
        raise ValueError("Expected position_mm = [x, y, z] in every [[leds]], got one without.")
    if "color" in values:
        return Led(**values)
    if "peak_nm" not in table:
        raise ValueError("Expected color = [red, green, blue] or peak_nm in every [[leds]], got one without.")
    strength = float(table.get("power", 1.0))
    width = {"width_nm": float(table["width_nm"])} if "width_nm" in table else {}
    red, green, blue = simulate.led_color(float(table["peak_nm"]), **width)
    return Led(color=(strength * red, strength * green, strength * blue), **values)


def _check(given: Mapping[str, Any], kind: Any, where: str, own: Sequence[str] = ()) -> None:
    """Refuse unknown keys and values of another type than the default, such as words for numbers."""
    defaults = {field.name: field.default for field in fields(kind)}
    keys = (*own, *defaults)
    for key, value in given.items():
        if key not in keys:
            raise ValueError(
                f"Unknown key {key!r} in {where}.{_nearest(key, keys)} Known: {', '.join(keys)}."
            )
        wanted, kinds = next((row for row in KINDS if isinstance(defaults.get(key), row[1])), ("", object))
        if value is not None and not isinstance(value, kinds):
            raise TypeError(f"Expected {key} as {wanted}, got {value!r}.")


def _ready_names() -> list[str]:
    return [*LAYOUTS, *(name for name, known in SENSORS.items() if known.preset is not None)]


def _nearest(word: str, known: Any) -> str:
    near = get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f" Did you mean {near[0]!r}?" if near else ""


def _frozen(value: Any) -> Any:
    """Lists as tuples, at every level."""
    return tuple(_frozen(item) for item in value) if isinstance(value, (list, tuple)) else value


RATE_HZ = 60.0  # frames a second
IMAGE_RATE_HZ = RATE_HZ / 2  # each image is shown twice
REST_IMAGES = 12  # images of the gel at rest before each object
BALL = Ball(2.5)  # mm, radius of the ball that rolls
ROLL_STEPS = 48  # images of one roll
ROLL = 0.3  # distance of the rolling ball from the middle, as a fraction of the image's width and height
STEP_MM = 0.025  # depths of requested presses are rounded to this, so that computed images can be reused
PRESS_S, HOLD_S = 0.35, 1.6  # s of a requested press: time of going in or out, and of staying


@dataclass(frozen=True, eq=False)
class PosedObject:
    """An object and its pose, in one image of the program."""

    indenter: Indenter
    pose: Pose


@dataclass(frozen=True)
class AskedPress:
    """A requested press: place (px), depth (mm), ball and time."""

    x_px: float
    y_px: float
    depth_mm: float
    ball: Ball
    start_s: float
    held_s: float

    def depth_at(self, now_s: float) -> float | None:
        """Depth in mm, 0 or less off the gel; None once the press is over."""
        going_in = now_s - self.start_s
        going_out = 2 * PRESS_S + self.held_s - going_in
        return None if going_out < 0 else self.depth_mm * min(1.0, going_in / PRESS_S, going_out / PRESS_S)


def serial_of_simulated(sensor: SimulatedSensor) -> str:
    """The serial number of a simulated sensor: the same for each sensor of a name."""
    return f"simulated-{sensor.name}"


class SimulatedSource(Closing, FrameReader):
    """Frames of a simulated sensor, evenly spaced in time, each with its own noise; late frames are skipped.

    A ball rolls, then a coin, a screw, letters and a ring are pressed, in a loop, until a press or rest is requested. Images
    without noise are computed once: those of the ball when first shown, the others in a thread. Each object joins the loop
    when its images are ready.

    Parameters
    ----------
    sensor : SimulatedSensor
    rate_hz : frames per second
    seed : of the noise and of the starting point in the program
    """

    live = True

    def __init__(self, sensor: SimulatedSensor, *, rate_hz: float = RATE_HZ, seed: int = 0) -> None:
        self.sensor = sensor
        self.rate_hz: float | None = check_positive(rate_hz, "rate_hz")
        self.name = f"simulated {sensor.name}"
        self.serial: str | None = serial_of_simulated(sensor)
        height, width = sensor.shape
        self.settings: dict[str, float | str] = {"width": width, "height": height, "fps": rate_hz}
        self._rate_hz, self._seed = rate_hz, seed
        self._linear = sensor.linear()
        self._objects = program(sensor)
        self._images = self._objects[0]
        self._levels: dict[PosedObject, Array] = {}
        self._pressed = lru_cache(maxsize=64)(self._levels_of_press)
        self._untouched = self._pressed(BALL, 0.0, 0.0, 0.0)
        self._asked: AskedPress | None = None
        self.resting = False
        self._closed = threading.Event()
        self._ahead: threading.Thread | None = None

    def _frames(self) -> Iterator[Frame]:
        ahead = threading.Thread(target=self._compute_ahead, name="simulated touches", daemon=True)
        ahead.start()
        self._ahead = ahead  # started: close() waits for this thread
        pace, index = Pace(), 0
        while not self._closed.is_set():
            image = self.image_at(index)  # before its time: a real exposure takes none of ours
            time_s = pace.wait_until(index / self._rate_hz)
            yield Frame(image, time_s, time.time_ns(), index)
            index = max(index + 1, int(pace.late_s(0.0) * self._rate_hz))  # a slow reader gets no old frames

    def image_at(self, index: int) -> Image:
        """The image (H, W, 3) uint8 RGB of a frame number."""
        levels = self._levels_now(index / self._rate_hz).astype(np.float32)
        return np.asarray(image_from_levels(self.sensor, levels, np.random.default_rng([self._seed, index])))

    def press_at(
        self,
        x_px: float,
        y_px: float,
        depth_mm: float = 0.5,
        *,
        ball_diameter_mm: float = 2 * BALL.radius_mm,
        held_s: float = HOLD_S,
    ) -> None:
        """Press a ball at a place of the image, hold it for a while, then lift it."""
        ball = Ball(ball_diameter_mm / 2)
        depth_mm = min(depth_mm, 0.9 * self.sensor.gel.thickness_mm, ball.radius_mm)
        self._asked = AskedPress(x_px, y_px, depth_mm, ball, time.monotonic(), held_s)

    def lift(self) -> None:
        """End the requested press."""
        self._asked = None

    def rest(self, resting: bool = True) -> None:
        """Touch nothing except on request; False: continue with the program."""
        self.resting = resting

    def close(self) -> None:
        """End the loop over this source; waits for the image that is being computed."""
        self._closed.set()
        if self._ahead is not None:
            self._ahead.join(2.0)

    def _levels_now(self, time_s: float) -> Array:
        """Linear gray levels (H, W, 3) of the current touch, before noise, response curve and rounding."""
        asked = self._asked
        depth_mm = None if asked is None else asked.depth_at(time.monotonic())
        if asked is not None and depth_mm is not None:
            depth_mm = STEP_MM * round(depth_mm / STEP_MM)
            if depth_mm <= 0:
                return self._untouched
            return self._pressed(asked.ball, depth_mm, asked.x_px, asked.y_px)
        images, at = self._images, int((time_s + self._seed) * IMAGE_RATE_HZ)  # seeds start a second apart
        touch = None if self.resting else images[at % len(images)]
        return self._untouched if touch is None else self._levels_of_touch(touch)

    def _levels_of_touch(self, touch: PosedObject) -> Array:
        if touch not in self._levels:
            self._levels[touch] = self._simulated(touch.indenter, touch.pose)
        return self._levels[touch]

    def _levels_of_press(self, ball: Ball, depth_mm: float, x_px: float, y_px: float) -> Array:
        height, width = self.sensor.shape
        middle_mm = np.array([x_px - (width - 1) / 2, y_px - (height - 1) / 2]) * self.sensor.mm_per_px
        return self._simulated(ball, Pose(depth_mm, tuple(middle_mm.tolist())))

    def _simulated(self, indenter: Indenter, pose: Pose) -> Array:
        press = simulate.simulate_pose(self._linear, indenter, pose, rng=None, quantise=False)
        return press.image.astype(np.float16)  # steps of 1/8 of a gray level: finer than the noise

    def _compute_ahead(self) -> None:
        """Compute the images of one object after the other; pauses at rest."""
        for images in self._objects[1:]:
            touches = [touch for touch in dict.fromkeys(images) if touch is not None]
            while touches:
                if self._closed.wait(1 / IMAGE_RATE_HZ):  # current frames come first
                    return
                if not self.resting:
                    self._levels_of_touch(touches.pop(0))
            self._images = [*self._images, *images]


def program(sensor: SimulatedSensor) -> list[list[PosedObject | None]]:
    """The touches of each object, image by image; None: nothing touches. Pressed objects leave the way they came."""
    height, width = (size * sensor.mm_per_px for size in sensor.shape)
    turn = np.linspace(0, 2 * np.pi, ROLL_STEPS, endpoint=False)
    step = np.arange(ROLL_STEPS)
    depths_mm = 0.5 * np.minimum(1, np.minimum(step, step[::-1]) / 8)
    # A ball goes in, rolls once around the middle, and goes out.
    rolling = [
        Pose(max(d, 0.02), (ROLL * width * float(np.cos(a)), ROLL * height * float(np.sin(a))))
        for d, a in zip(depths_mm.tolist(), turn)
    ]
    objects = [[*[None] * REST_IMAGES, *(PosedObject(BALL, pose) for pose in rolling)]]
    steps = round(PRESS_S * IMAGE_RATE_HZ)
    for indenter, depth_mm, spin_deg, tilt_deg in (
        (simulate.Coin(), 0.35, 0.0, 0.0),
        (simulate.Screw(), 0.45, 25.0, 0.0),
        (simulate.text_relief("gelform", height_mm=2.0), 0.3, 0.0, 0.0),
        (simulate.Torus(2.8, 0.9), 0.5, 0.0, 4.0),
    ):
        fractions = np.sin(np.linspace(0, np.pi / 2, steps + 1)[1:]) ** 2
        going_in = [
            PosedObject(indenter, Pose(depth_mm * f, spin_deg=spin_deg * f, tilt_deg=(tilt_deg * f, 0.0)))
            for f in fractions.tolist()
        ]
        objects.append([*[None] * REST_IMAGES, *going_in, *going_in[::-1]])
    return objects
