"""USB cameras: which are plugged in, which one is meant, how they are set, and their frames; imported when asked for."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "access": ["check_access", "udev_rule"],
        "camera": ["Camera", "chosen_camera", "listed_cameras"],
        "modes": ["modes_of"],
        "settings": ["calibrated_settings", "settings_mismatch"],
        "survey": ["Survey", "survey_of"],
        "sysfs": ["cameras_in_sysfs"],
        "there": ["camera_named", "cameras_there"],
        "usb": ["UsbCamera"],
    },
)
