"""Starters: what units of one make of sensor have in common, so that depth is there before anything was pressed."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "light": ["check_light", "levels_from_light", "light_from_background"],
        "starter": [
            "Starter",
            "calibration_from_background",
            "load_starter",
            "starter_for",
            "starter_names",
            "starter_of_source",
        ],
    },
)
