"""The live page without hardware: a simulated sensor that objects touch, and its calibration."""
