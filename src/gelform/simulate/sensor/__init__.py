"""The simulated sensor and its camera."""

from gelform.simulate.sensor.sensor import led_ring, led_row

__all__ = ["led_ring", "led_row"]
