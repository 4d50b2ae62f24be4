"""What is pressed into the gel, and how it stands."""

from gelform.simulate.indenters.faces import Ball, Coin, HeightMap, Indenter, Screw
from gelform.simulate.indenters.mesh import Mesh
from gelform.simulate.indenters.pose import Pose
from gelform.simulate.indenters.scene import Placed, Posed, Several
from gelform.simulate.indenters.shapes import BoxEdge, Cone, Cylinder, Punch, Pyramid, Torus, text_relief

__all__ = [
    "Ball",
    "BoxEdge",
    "Coin",
    "Cone",
    "Cylinder",
    "HeightMap",
    "Indenter",
    "Mesh",
    "Placed",
    "Pose",
    "Posed",
    "Punch",
    "Pyramid",
    "Screw",
    "Several",
    "Torus",
    "text_relief",
]
