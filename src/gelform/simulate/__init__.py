"""The simulator: indenter, gel, lights, camera -> image and exact truth. Arrays only."""

from gelform.simulate.indenters import Ball, Coin, HeightMap, Indenter, Screw
from gelform.simulate.layouts import LAYOUTS
from gelform.simulate.press import (
    SimulatedPress,
    SimulatedPresses,
    exposed,
    simulate_background,
    simulate_ball_presses,
    simulate_press,
)
from gelform.simulate.sensor import Led, SimulatedSensor

__all__ = [
    "LAYOUTS",
    "Ball",
    "Coin",
    "HeightMap",
    "Indenter",
    "Led",
    "Screw",
    "SimulatedPress",
    "SimulatedPresses",
    "SimulatedSensor",
    "exposed",
    "simulate_background",
    "simulate_ball_presses",
    "simulate_press",
]
