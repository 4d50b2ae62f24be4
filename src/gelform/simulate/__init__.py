"""The simulator: indenter, gel, lights, camera -> image and exact truth. Arrays only."""

from gelform.simulate.gel.gel import Drag, Gel, relaxation_from_gel
from gelform.simulate.indenters.faces import (
    Ball,
    BoxEdge,
    Coin,
    Cone,
    Cylinder,
    HeightMap,
    Indenter,
    Punch,
    Pyramid,
    Screw,
    Torus,
    text_relief,
)
from gelform.simulate.indenters.mesh import Mesh
from gelform.simulate.indenters.pose import Placed, Pose, Posed, Several
from gelform.simulate.presets import LAYOUTS
from gelform.simulate.press import SimulatedPress, simulate_pose, simulate_press
from gelform.simulate.render import exposed, simulate_background
from gelform.simulate.sensor.coating import Coating
from gelform.simulate.sensor.sensor import Led, Optics, SimulatedSensor, Timing, led_color
from gelform.simulate.sets import (
    SimulatedPresses,
    press_poses,
    roll_poses,
    simulate_ball_presses,
    simulate_sequence,
    slide_poses,
    twist_poses,
)
from gelform.simulate.twin import Twin

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
    "Twin",
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
