"""Simulated sensors by name, from settings, or from a TOML file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from difflib import get_close_matches
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from gelform.errors import SensorError
from gelform.sensors.profiles import SENSORS
from gelform.sensors.toml_files import read_toml
from gelform.simulate.gel.gel import Gel
from gelform.simulate.presets import LAYOUTS
from gelform.simulate.render import exposed
from gelform.simulate.sensor.coating import Coating
from gelform.simulate.sensor.sensor import Led, Optics, SimulatedSensor, Timing, led_color

SECTIONS = {"gel": Gel, "coating": Coating, "optics": Optics, "timing": Timing}
OWN_KEYS = ("base", "exposed_levels")
LED_KEYS = ("peak_nm", "width_nm", "power")
KINDS: tuple[tuple[str, Any], ...] = (
    ("true or false", bool),
    ("a number", (int, float)),
    ("text", str),
    ("a list", (list, tuple)),
)


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
    given = {
        key: _frozen(value) for key, value in settings.items() if key not in (*OWN_KEYS, *SECTIONS, "leds")
    }
    if "leds" in settings:
        given["leds"] = tuple(_led(led) for led in _tables(settings["leds"]))
    base = simulated_sensor_named(str(settings["base"])) if "base" in settings else None
    if base is None and "leds" not in given:
        raise ValueError(
            f"Expected base (one of {', '.join(_ready_names())}) or a list of [[leds]], got neither."
        )
    for name, kind in SECTIONS.items():
        if name in settings:
            given[name] = _section(name, kind, settings[name], base)
    sensor = SimulatedSensor(**given) if base is None else replace(base, **given)
    return exposed(sensor, _frozen(settings["exposed_levels"])) if "exposed_levels" in settings else sensor


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
    red, green, blue = led_color(float(table["peak_nm"]), float(table.get("width_nm", 25.0)))
    return Led(color=(strength * red, strength * green, strength * blue), **values)


def _tables(leds: Any) -> Sequence[Mapping[str, Any]]:
    if not isinstance(leds, Sequence) or not all(isinstance(led, Mapping) for led in leds):
        raise TypeError(f"Expected leds as tables, [[leds]], got {leds!r}.")
    return leds


def _check(given: Mapping[str, Any], kind: Any, where: str, own: Sequence[str] = ()) -> None:
    """Refuse unknown keys and values of another type than the default, such as words for numbers."""
    defaults = {field.name: field.default for field in fields(kind)}
    known = (*own, *defaults)
    for key, value in given.items():
        if key not in known:
            raise ValueError(
                f"Unknown key {key!r} in {where}.{_nearest(key, known)} Known: {', '.join(known)}."
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
