"""Simulated sensors as sources of frames, and their settings from files; submodules are imported on first use."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "settings": ["read_simulated_sensor", "sensor_from_settings", "simulated_sensor_named"],
        "source": ["SimulatedSource"],
    },
)
