"""The simulator: indenter, gel, lights, camera -> image and exact truth. Arrays only."""

from gelform.simulate.gel.gel import Gel, relaxation_from_gel
from gelform.simulate.indenters.faces import Ball, Coin, HeightMap, Indenter, Screw
from gelform.simulate.indenters.mesh import Mesh
from gelform.simulate.indenters.scene import Placed, Posed, Several
from gelform.simulate.indenters.shapes import BoxEdge, Cone, Cylinder, Punch, Pyramid, Torus, text_relief
from gelform.simulate.light.coating import Coating
from gelform.simulate.light.light import led_color
from gelform.simulate.motion import Drag, Pose, press_poses, roll_poses, slide_poses, twist_poses
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
from gelform.simulate.sensor.layouts import LAYOUTS
from gelform.simulate.sensor.optics import Optics
from gelform.simulate.sensor.sensor import Led, SimulatedSensor
from gelform.simulate.sensor.timing import Timing

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
