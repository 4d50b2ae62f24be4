"""Calibration step by step on the page: background, presses where they help most, fit, report, use."""
