"""Numbers: positive, within limits, widths of a pixel, points."""

import numpy as np
import pytest

from gelform.checks import check_mm_per_px, check_numbers, check_positive, check_sensor_pitch, check_within


@pytest.mark.parametrize(
    ("given_", "pair"), [(0.1, (0.1, 0.1)), ((0.1, 0.2), (0.1, 0.2)), (np.float32(0.5), (0.5, 0.5))]
)
def test_pitch_of_square_and_other_pixels(given_, pair):
    assert check_mm_per_px(given_) == pair


@pytest.mark.parametrize("pitch", [0, -1, np.nan, np.inf, (0.1, 0)])
def test_pitch_must_be_positive(pitch):
    with pytest.raises(ValueError, match=r"mm_per_px > 0 \(mm per pixel, not pixels per mm\)"):
        check_mm_per_px(pitch)


def test_pitch_missing_or_in_words():
    with pytest.raises(ValueError, match="got None"):
        check_mm_per_px(None)
    with pytest.raises(TypeError, match="number or"):
        check_mm_per_px("small")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="shape"):
        check_mm_per_px((1, 2, 3))


def test_positive_numbers():
    assert check_positive(np.float32(2), "size") == 2.0
    with pytest.raises(ValueError, match="size > 0, got 0"):
        check_positive(0, "size")
    with pytest.raises(TypeError, match="size as a number"):
        check_positive("wide", "size")  # type: ignore[arg-type]
    for value in ("2", True, np.True_):
        with pytest.raises(TypeError, match="size as a number, got"):
            check_positive(value, "size")


def test_a_sensors_pitch_is_small():
    assert check_sensor_pitch(0.0634) == 0.0634
    with pytest.raises(
        ValueError, match=r"up to 1 mm, got 15.8. If these are pixels per mm, give 1/15.8 = 0.06329"
    ):
        check_sensor_pitch(15.8)
    with pytest.raises(ValueError, match=r"got 1e\+300.$"):
        check_sensor_pitch(1e300)


def test_ranges_and_what_is_no_number():
    assert check_within(3, "size", 0, 5) == 3.0
    with pytest.raises(ValueError, match="size between 0 and 5, got 6"):
        check_within(6, "size", 0, 5)
    with pytest.raises(ValueError, match="size between 0 and 5, got nan"):
        check_within(float("nan"), "size", 0, 5)
    for odd in ("3", True, [3], None, [[1, 2], [3]], 1j):
        with pytest.raises(TypeError, match="size as a number"):
            check_within(odd, "size", 0, 5)


def test_points():
    assert check_numbers((1, np.float32(2.5)), "center", 2) == (1.0, 2.5)
    assert check_numbers(np.array([1.0, 2.0, 3.0]), "circle", 3) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    ("values", "error", "said"),
    [
        ((1, 2, 3), ValueError, "center as 2 finite numbers"),
        ((1, float("nan")), ValueError, "center as 2 finite numbers"),
        ((1, "2"), TypeError, "each of center as a number, got '2'"),
        (3.0, TypeError, "center as a list, got float"),
        (np.array(3.0), TypeError, "center as a list, got ndarray"),
    ],
)
def test_what_is_no_point(values, error, said):
    with pytest.raises(error, match=said):
        check_numbers(values, "center", 2)
