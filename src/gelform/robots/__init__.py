"""Results for robots' software: bags (extra `ros`) and live topics of ROS 2 (`zenoh`), depth for LeRobot's video."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "bag_file": ["BagFile"],
        "lerobot_depth": ["depth_from_lerobot_levels", "lerobot_levels_from_depth"],
        "send": ["SentStats", "publish", "save_bag"],
        "topics": ["TOPICS"],
        "zenoh_node": ["ZenohNode"],
    },
)
