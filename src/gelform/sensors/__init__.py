"""Sources of frames and images, and the table of known sensors; submodules are imported on first use."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "cameras": ["calibrated_settings", "cameras_there", "settings_mismatch"],
        "films": ["Video"],
        "files": ["SensorSettings", "read_background", "read_image", "read_sensor_toml"],
        "grabber": ["Grabber"],
        "profiles": ["SENSORS"],
        "record": ["new_recording", "record_frames"],
        "simulated": [
            "SimulatedSource",
            "read_simulated_sensor",
            "sensor_from_settings",
            "simulated_sensor_named",
        ],
        "source": ["Source", "open_source"],
    },
)
