"""A camera that hangs gives one image again and again."""

import numpy as np

from gelform.streams.health.frozen import Frozen

IMAGE = np.random.default_rng(0).integers(0, 255, (40, 50, 3), dtype=np.uint8)


def names(images, rate_hz):
    frozen = Frozen()
    return [bool(frozen(image, index / rate_hz)) for index, image in enumerate(images)]


def other(row):
    image = IMAGE.copy()
    image[row, 3, 1] ^= 1
    return image


def test_noise_in_one_pixel_is_life():
    assert not any(names([IMAGE if i % 2 else other(17) for i in range(40)], 25))


def test_one_image_for_a_while_is_frozen():
    found = names([other(3)] + [IMAGE.copy()] * 20, 25)
    assert found.index(True) == 8  # 0.25 s after the first of them
    assert all(found[8:])


def test_frames_that_come_twice_are_none():
    assert not any(names([image for row in range(30) for image in (other(row), other(row).copy())], 25))


def test_it_ends_with_the_next_image():
    frozen = Frozen()
    for index in range(20):
        found = frozen(IMAGE, index / 10)
    assert found[0].figure == 1.9
    assert frozen(other(5), 2.0) == ()
