"""Frames and images that come in, and what is known of the sensors that made them; imported when asked for."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "cameras": ["calibrated_settings", "cameras_there", "settings_mismatch"],
        "files": [
            "SensorSettings",
            "averaged_background",
            "background_files",
            "background_in",
            "read_background",
            "read_image",
            "read_sensor_toml",
        ],
        "grabber": ["Grabber", "GrabberStats"],
        "playback": ["Playback", "folder_playback", "video_playback"],
        "profiles": ["PROFILES", "SENSORS", "KnownSensor", "SensorProfile", "profile_named"],
        "recordings.record": ["RecordStats", "Recording", "new_recording", "record_frames"],
        "simulated": ["SimulatedSource"],
        "simulated.settings": ["read_simulated_sensor", "sensor_from_settings", "simulated_sensor_named"],
        "source": ["Source", "open_source"],
        "video_files": ["Video", "VideoFacts"],
    },
)
