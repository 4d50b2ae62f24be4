"""What a simulated sensor is, and what its camera makes of light."""

from gelform.simulate.sensor.sensor import led_ring, led_row

__all__ = ["led_ring", "led_row"]
