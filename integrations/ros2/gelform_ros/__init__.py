"""Depth in millimeters of a visual-tactile sensor as topics of ROS 2."""
