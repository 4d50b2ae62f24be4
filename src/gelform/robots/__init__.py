"""Results for robot software: ROS 2 bags (extra `ros`), live ROS 2 topics (rclpy, zenoh), depth for LeRobot's video."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "lerobot_depth": ["depth_from_lerobot_levels", "lerobot_levels_from_depth"],
        "ros_messages": ["TOPICS"],
        "send": ["BagFile", "RclpyNode", "SentStats", "ZenohNode", "publish", "save_bag"],
    },
)
