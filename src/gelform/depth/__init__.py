"""From slopes to depth in millimeters, with its standard deviation, its zero and the contacts."""
