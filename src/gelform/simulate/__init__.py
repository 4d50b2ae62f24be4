"""The simulator: indenter, gel, lights, camera -> image and exact truth. Arrays only."""

from gelform.simulate.background import exposed, simulate_background
from gelform.simulate.gel.drag import Drag
from gelform.simulate.gel.gel import Gel, relaxation_from_gel
from gelform.simulate.indenters.faces import Ball, Coin, HeightMap, Indenter, Screw
from gelform.simulate.indenters.mesh import Mesh
from gelform.simulate.indenters.pose import Pose
from gelform.simulate.indenters.scene import Placed, Posed, Several
from gelform.simulate.indenters.shapes import BoxEdge, Cone, Cylinder, Punch, Pyramid, Torus, text_relief
from gelform.simulate.press import SimulatedPress, simulate_pose, simulate_press
from gelform.simulate.sensor.coating import Coating
from gelform.simulate.sensor.layouts import LAYOUTS
from gelform.simulate.sensor.led import Led, led_color
from gelform.simulate.sensor.optics import Optics
from gelform.simulate.sensor.sensor import SimulatedSensor
from gelform.simulate.sensor.timing import Timing
from gelform.simulate.sequence import press_poses, roll_poses, simulate_sequence, slide_poses, twist_poses
from gelform.simulate.sets import SimulatedPresses, simulate_ball_presses
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
