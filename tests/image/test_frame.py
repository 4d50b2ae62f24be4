"""Frames, and the identity of their pixels."""

import numpy as np
import pytest

from gelform.image.frame import Frame, pixels_digest


def test_the_digest_tells_values_shapes_and_dtypes_apart():
    image = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    changed = image.copy()
    changed[1, 2, 0] += 1
    others = [changed, image.reshape(4, 2, 3), image.astype(np.float32)]
    digests = {pixels_digest(one) for one in (image, *others)}
    assert len(digests) == 4
    assert pixels_digest(image.copy()) == pixels_digest(image)


def test_the_digest_is_of_the_pixels_not_of_their_layout():
    image = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    assert pixels_digest(image[:, ::-1]) == pixels_digest(np.ascontiguousarray(image[:, ::-1]))
    assert len(pixels_digest(image)) == 64


def test_a_frame_does_not_change():
    frame = Frame(np.zeros((2, 2, 3), dtype=np.uint8), time_s=1.0, wall_time_ns=2, index=3)
    with pytest.raises(AttributeError):
        frame.index = 4
