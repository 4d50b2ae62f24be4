"""A camera behind OpenCV's interface that keeps its properties and returns the pictures of a list."""

import cv2
import numpy as np

from made.mjpeg_server import jpeg


class Capture:
    """Lacks the controls that are not in `properties`; clips those in `limits`."""

    def __init__(self, pictures=(), limits=None, **properties):
        self.pictures = list(pictures)
        self.limits = limits or {}
        self.released = 0
        self.properties = {
            cv2.CAP_PROP_FRAME_WIDTH: 320.0,
            cv2.CAP_PROP_FRAME_HEIGHT: 240.0,
            cv2.CAP_PROP_FPS: 30.0,
            cv2.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*"YUYV")),
            cv2.CAP_PROP_CONVERT_RGB: 1.0,
            cv2.CAP_PROP_POS_MSEC: 0.0,
            **{getattr(cv2, f"CAP_PROP_{name.upper()}"): value for name, value in properties.items()},
        }

    def isOpened(self):
        return True

    def get(self, which):
        return self.properties.get(which, -1.0)

    def set(self, which, value):
        if which not in self.properties:
            return False
        low, high = self.limits.get(which, (-np.inf, np.inf))
        self.properties[which] = min(max(value, low), high)
        return True

    def grab(self):
        return bool(self.pictures)

    def retrieve(self):
        picture = self.pictures.pop(0)
        if self.properties[cv2.CAP_PROP_CONVERT_RGB] == 0 and picture is not None:
            return True, np.frombuffer(picture, np.uint8)[None]
        return picture is not None, picture

    def release(self):
        self.released += 1


def large_jpeg(color=(200, 30, 10)):
    return jpeg((960, 1280), color)
