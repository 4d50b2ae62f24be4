"""Picture files hold the pixels that were given, red first."""

import cv2
import numpy as np
import pytest

from gelform.errors import DataError
from gelform.foundations.pictures import FAST_PNG, picture_bytes

IMAGE = np.random.default_rng(0).integers(0, 256, (7, 9, 3)).astype(np.uint8)


def decoded(content):
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)


@pytest.mark.parametrize("settings", [(), FAST_PNG])
def test_images_come_back_with_red_first(settings):
    np.testing.assert_array_equal(decoded(picture_bytes(IMAGE, settings=settings))[..., ::-1], IMAGE)


def test_maps_keep_their_type():
    levels = IMAGE[..., 0].astype(np.uint16) * 257
    np.testing.assert_array_equal(decoded(picture_bytes(levels)), levels)
    depth = levels.astype(np.float32) / 7
    np.testing.assert_array_equal(decoded(picture_bytes(depth, ".tiff")), depth)


def test_what_no_picture_holds_is_refused():
    with pytest.raises(DataError, match="cannot encode a picture of 0x4 px as PNG"):
        picture_bytes(np.zeros((0, 4, 3), np.uint8))
