"""USB cameras: which are plugged in, which one is meant, how they are set, and their frames; imported when asked for."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "camera": ["Camera", "camera_named", "cameras_there", "chosen_camera", "listed_cameras"],
        "settings": ["calibrated_settings", "settings_mismatch"],
        "survey": ["Survey", "modes_of", "survey_of"],
        "usb": ["UsbCamera", "check_access", "udev_rule"],
    },
)
