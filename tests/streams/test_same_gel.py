"""A gel that has moved, or is another one, is known by its texture."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import simulate_background
from gelform.simulate.sensor.coating import Coating
from gelform.streams.background_drift import Evidence
from gelform.streams.same_gel import SameGel
from stream.sensor_faults import Gel, moved


@pytest.fixture(scope="module")
def gel(sensor):
    return Gel.drawn(sensor, np.random.default_rng(1))


def looks(start, images, *, touched=0.0, different=0.0):
    same_gel, shape = SameGel(start.astype(np.float32)), start.shape[:2]
    somewhere = np.zeros(shape, bool)
    somewhere[: int(touched * shape[0])] = True
    light, nowhere = np.ones((*shape, 3), np.float32), np.zeros(shape, bool)
    return [
        same_gel(Evidence(image.astype(np.float32), start, light, somewhere, nowhere, different))
        for image in images
    ]


def noisy(gel, count=4, seed=5):
    rng = np.random.default_rng(seed)
    return [gel.rest + rng.normal(0, 0.2, gel.rest.shape) for _ in range(count)]


def test_the_same_gel_in_its_place(gel):
    assert looks(gel.rest, noisy(gel)) == [()] * 4


def test_a_camera_that_moved(gel):
    image = moved(gel.rest, np.random.default_rng(3))
    found = looks(gel.rest, [image])[0]
    assert found[0].name == "camera_moved"
    assert 1 <= found[0].figure <= 4.5


def test_another_gel(gel, sensor):
    other = Gel.drawn(sensor, np.random.default_rng(2))
    found = looks(gel.rest, noisy(other))
    assert found[-1][0].name == "other_gel"
    assert found[0] == ()


def test_a_smooth_gel_in_place_of_a_rough_one(sensor):
    """It promises a correlation of a tenth: little, but the same gel would show it."""
    coatings = [Coating(roughness=roughness, seed=seed) for roughness, seed in ((0.009, 1), (0.003, 2))]
    rough, smooth = (
        simulate_background(replace(sensor, coating=one), None, quantise=False) for one in coatings
    )
    rng = np.random.default_rng(5)
    for start, images in ((rough, smooth), (smooth, smooth)):
        frames = [images + rng.normal(0, 0.4, images.shape) for _ in range(4)]
        names = [finding.name for finding in looks(start, frames)[-1]]
        assert names == ([] if start is smooth else ["other_gel"])


def test_what_is_touched_all_over_says_nothing(gel):
    image = moved(gel.rest, np.random.default_rng(3))
    assert looks(gel.rest, [image] * 3, touched=0.9) == [()] * 3


def test_frames_that_differ_for_long_are_of_another_gel(gel):
    found = looks(gel.rest, noisy(gel), different=1.0)
    assert found[1] == ()
    assert found[3][0].name == "other_gel"
