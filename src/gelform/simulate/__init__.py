"""The simulator: indenter, gel, lights, camera -> image and exact truth. Arrays only."""

from gelform.simulate.coating import Coating
from gelform.simulate.gel import Gel, relaxation_from_gel
from gelform.simulate.indenters import Ball, Coin, HeightMap, Indenter, Screw
from gelform.simulate.layouts import LAYOUTS
from gelform.simulate.light import led_color
from gelform.simulate.mesh import Mesh
from gelform.simulate.motion import Drag, Pose, press_poses, roll_poses, slide_poses, twist_poses
from gelform.simulate.optics import Optics
from gelform.simulate.press import (
    SimulatedPress,
    SimulatedPresses,
    exposed,
    simulate_background,
    simulate_ball_presses,
    simulate_pose,
    simulate_press,
    simulate_sequence,
)
from gelform.simulate.scene import Placed, Posed, Several
from gelform.simulate.sensor import Led, SimulatedSensor
from gelform.simulate.shapes import BoxEdge, Cone, Cylinder, Punch, Pyramid, Torus, text_relief
from gelform.simulate.timing import Timing

__all__ = [
    "LAYOUTS",
    "Ball",
    "BoxEdge",
    "Coating",
    "Coin",
    "Cone",
    "Cylinder",
    "Drag",
    "Gel",
    "HeightMap",
    "Indenter",
    "Led",
    "Mesh",
    "Optics",
    "Placed",
    "Pose",
    "Posed",
    "Punch",
    "Pyramid",
    "Screw",
    "Several",
    "SimulatedPress",
    "SimulatedPresses",
    "SimulatedSensor",
    "Timing",
    "Torus",
    "exposed",
    "led_color",
    "press_poses",
    "relaxation_from_gel",
    "roll_poses",
    "simulate_background",
    "simulate_ball_presses",
    "simulate_pose",
    "simulate_press",
    "simulate_sequence",
    "slide_poses",
    "text_relief",
    "twist_poses",
]
