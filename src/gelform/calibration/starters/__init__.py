"""Starters: the common properties of the units of a make, which give depth before any press."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "starter": [
            "Starter",
            "calibration_from_background",
            "check_light",
            "levels_from_light",
            "light_from_background",
            "load_starter",
            "make_name",
            "starter_for",
            "starter_names",
            "starter_of_make",
            "starter_of_source",
        ]
    },
)
