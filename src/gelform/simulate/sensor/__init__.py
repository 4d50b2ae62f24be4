"""What a simulated sensor is, and what its camera makes of light."""

from gelform.simulate.sensor.camera import levels_from_irradiance
from gelform.simulate.sensor.coating import Coating
from gelform.simulate.sensor.grey_levels import image_from_levels, saturated_from_levels
from gelform.simulate.sensor.layouts import LAYOUTS
from gelform.simulate.sensor.led import Led, led_color, led_ring, led_row
from gelform.simulate.sensor.optics import Optics
from gelform.simulate.sensor.projection import maps_from_depth, px_seen
from gelform.simulate.sensor.sensor import SimulatedSensor
from gelform.simulate.sensor.timing import Timing

__all__ = [
    "Coating",
    "LAYOUTS",
    "Led",
    "Optics",
    "SimulatedSensor",
    "Timing",
    "image_from_levels",
    "led_color",
    "led_ring",
    "led_row",
    "levels_from_irradiance",
    "maps_from_depth",
    "px_seen",
    "saturated_from_levels",
]
