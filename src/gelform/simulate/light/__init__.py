"""Light from the LEDs on the gel's surface, up to the image."""

from gelform.simulate.light.irradiance import irradiance_from_surface
from gelform.simulate.light.scattering import spread_in_gel
from gelform.simulate.light.shadows import shadowed_from_surface, visible_from_surface

__all__ = [
    "irradiance_from_surface",
    "shadowed_from_surface",
    "spread_in_gel",
    "visible_from_surface",
]
