"""The library: the user's calibrations in one folder, found by their camera."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "library": [
            "Choice",
            "Entry",
            "Unit",
            "add_calibration",
            "choose_calibration",
            "entries",
            "library_folder",
            "matching",
            "unit_of",
        ]
    },
)
