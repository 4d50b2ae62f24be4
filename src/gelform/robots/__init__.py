"""Results for robots' software: bags of ROS 2 (extra `ros`), depth that LeRobot's video keeps."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "bag": ["BagStats", "save_bag"],
        "bag_file": ["BagFile"],
        "lerobot_depth": ["depth_from_lerobot_levels", "lerobot_levels_from_depth"],
        "topics": ["TOPICS"],
    },
)
