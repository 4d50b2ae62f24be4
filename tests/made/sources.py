"""Sources of frames for tests: images at a pace, or as fast as they are read."""

import time

from gelform.image.frame import Frame


class ImageSource:
    """Frames of the images given, again and again or once; `fails` is raised after the last."""

    serial = None

    def __init__(self, images, *, rate_hz=100.0, live=True, count=None, fails=None):
        self.images, self.rate_hz, self.live = images, rate_hz, live
        self.count, self.fails = count, fails
        self.name, self.settings = "images", {}
        self.closed = False

    def __iter__(self):
        index = 0
        while not self.closed and (self.count is None or index < self.count):
            if self.live:
                time.sleep(1 / self.rate_hz)
            image = self.images[index % len(self.images)]
            yield Frame(image, time.monotonic() if self.live else index / self.rate_hz, index, index)
            index += 1
        if self.fails is not None:
            raise self.fails

    def close(self):
        self.closed = True

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
