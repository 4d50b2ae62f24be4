"""The surface of the gel under an indenter, and how it is dragged sideways."""

from gelform.simulate.gel.ball_press import (
    BallPress,
    ball_on_grid,
    contact_radius_of_ball,
    depth_of_ball,
)
from gelform.simulate.gel.drag import Drag, displacement_at, thinned
from gelform.simulate.gel.gel import (
    Gel,
    Surface,
    cropped,
    flat_surface,
    relaxation_from_gel,
    surface_from_ball,
    surface_from_indenter,
)
from gelform.simulate.gel.membrane import bulging_membrane_over, carried_along, membrane_over, spread

__all__ = [
    "BallPress",
    "Drag",
    "Gel",
    "Surface",
    "ball_on_grid",
    "bulging_membrane_over",
    "carried_along",
    "contact_radius_of_ball",
    "cropped",
    "depth_of_ball",
    "displacement_at",
    "flat_surface",
    "membrane_over",
    "relaxation_from_gel",
    "spread",
    "surface_from_ball",
    "surface_from_indenter",
    "thinned",
]
