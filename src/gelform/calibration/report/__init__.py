"""What a calibration run found, in numbers, in words and on a page."""
