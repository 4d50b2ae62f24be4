"""The light of a make: smooth, thirty numbers, and what tells an uneven background from it."""

import numpy as np
import pytest

from gelform.calibration.starters import check_light, levels_from_light, light_from_background, load_starter
from gelform.errors import CalibrationError


def test_an_uneven_background_is_warned_of():
    make = load_starter("gelsight-mini")
    touched = make.calibration.background.copy()
    touched[40:200, 80:140] *= np.float32([1.9, 0.4, 1.6])
    names = {one.name for one in check_light(touched, make.light, make.make)}
    assert "uneven_background" in names
    assert check_light(make.calibration.background, make.light, make.make) == ()


def test_a_dark_surround_is_named_with_the_crop_that_fits():
    make, other = load_starter("gelsight-mini"), load_starter("digit")
    image = make.calibration.background.copy()
    image[-20:] = 2
    found = {one.name: one for one in check_light(image, make.light, make.make)}
    assert found["dark_surround"].figure == pytest.approx(20 / len(image), abs=0.01)
    assert "crop the frames to 0,0,320,215" in found["dark_surround"].message
    with pytest.raises(CalibrationError, match=r"Is it another sensor.*crop the frames to 0,0,320,215"):
        check_light(image, other.light, other.make)


@pytest.mark.parametrize("shape", [(240, 320), (320, 240), (41, 60)])
def test_a_smooth_light_comes_back_from_its_image(shape):
    y, x = np.mgrid[: shape[0], : shape[1]] / np.array(shape).reshape(2, 1, 1)
    logs = np.stack([4 + 0.5 * x - x * y, 4.2 - y**3, 3.9 + 0.3 * x**2 * y], axis=-1)
    light, rough = light_from_background(np.exp(logs) - 1)
    assert rough < 5e-3
    np.testing.assert_allclose(levels_from_light(light, x, y), np.exp(logs) - 1, rtol=0.05)
