"""color_change: division and subtraction, their inverse, and backgrounds that do not belong."""

import numpy as np
import pytest

from gelform.background import (
    ChangeSettings,
    check_background,
    color_change_from_image,
    image_from_color_change,
    untouched_from_color_change,
)
from gelform.errors import CalibrationError

SHAPE = (60, 80)


def scene(seed: int = 0) -> np.ndarray:
    """A smooth, unevenly lit background with noise, channels clearly different."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 80
    levels = np.stack([60 + 90 * x, 110 - 40 * y, 80 + 60 * (1 - x) * y], axis=-1)
    return (levels + np.random.default_rng(seed).normal(0, 1, levels.shape)).astype(np.float32)


def touched(background: np.ndarray) -> np.ndarray:
    image = background.copy()
    image[20:40, 30:50] += np.array([40, -30, 20], dtype=np.float32)
    return np.clip(image, 0, 255)


@pytest.mark.parametrize("method", ["divide", "subtract"])
@pytest.mark.parametrize("offset", [0.0, 10.0])
def test_change_and_image_are_inverse(method, offset):
    settings = ChangeSettings(method, offset)
    rest = scene()
    image = touched(rest)
    change = color_change_from_image(image, rest, settings)
    np.testing.assert_allclose(image_from_color_change(change, rest, settings), image, atol=1e-3)


def test_division_is_the_relative_change():
    rest = np.full((*SHAPE, 3), 90, dtype=np.uint8)
    image = np.full((*SHAPE, 3), 140, dtype=np.uint8)
    np.testing.assert_allclose(color_change_from_image(image, rest), 0.5, rtol=1e-6)
    subtracted = color_change_from_image(image, rest, ChangeSettings("subtract"))
    np.testing.assert_allclose(subtracted, 50 / 255, rtol=1e-6)


def test_darker_than_the_background_is_negative():
    rest = np.full((*SHAPE, 3), 90, dtype=np.uint8)
    assert color_change_from_image(rest // 2, rest).max() < 0


def test_division_by_zero_is_refused():
    rest = np.zeros((*SHAPE, 3), dtype=np.uint8)
    with pytest.raises(ValueError, match="Give an offset"):
        color_change_from_image(rest, rest, ChangeSettings("divide", 0.0))


def test_unknown_method_is_refused():
    with pytest.raises(ValueError, match="'divide' or 'subtract'"):
        ChangeSettings("ratio")  # type: ignore[arg-type]


def test_own_background_gives_no_finding():
    rest = scene()
    assert check_background(touched(scene(1)), rest) == ()


@pytest.mark.parametrize("gain", [0.86, 1.15])
def test_brightness_drift_is_a_warning_with_its_figure(gain):
    (finding,) = check_background(np.clip(touched(scene(1)) * gain, 0, 255), scene())
    assert finding.name == "background_ratio"
    assert finding.figure == pytest.approx(gain, abs=0.03)
    assert "new background" in finding.message


@pytest.mark.parametrize("gain", [0.6, 1.5])
def test_other_exposure_is_refused_with_its_figure(gain):
    with pytest.raises(CalibrationError, match=rf"R {gain:.1f}\d, G [\d.]+, B [\d.]+ times as bright"):
        check_background(np.clip(touched(scene(1)) * gain, 0, 255), scene())


def test_other_scene_is_refused():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    ours, theirs = (100 + 20 * np.sin(0.4 * np.stack([k, k, k], axis=-1)) for k in (x, y))
    with pytest.raises(CalibrationError, match=r"correlate by -?0\.\d"):
        check_background(theirs, ours)


def test_reversed_channels_are_named():
    with pytest.raises(CalibrationError, match="looks like BGR"):
        check_background(touched(scene(1))[..., ::-1], scene())


def test_a_third_of_the_frame_touched_is_no_other_background():
    image = scene(1)
    image[:, :27] += np.array([45, -35, 25], dtype=np.float32)
    assert check_background(np.clip(image, 0, 255), scene()) == ()


def test_untouched_ignores_an_exposure_step():
    rest = scene()
    change = color_change_from_image(np.clip(touched(rest) * 1.05, 0, 255), rest)
    untouched = untouched_from_color_change(change, 0.05)
    assert untouched[:15].all()
    assert not untouched[22:38, 32:48].any()
