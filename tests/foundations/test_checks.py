"""The one door: what is let in, as what, and what is said to the rest."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gelform.errors import DataError
from gelform.foundations import checks
from gelform.foundations.checks import (
    HIGHEST_SLOPE,
    as_array,
    check_choice,
    check_gradients,
    check_image,
    check_is,
    check_list,
    check_map,
    check_mask,
    check_mm_per_px,
    check_normals,
    check_numbers,
    check_path,
    check_positive,
    check_sensor_pitch,
    check_slopes,
    check_values,
    check_within,
)
from gelform.image.view import View
from kernel_agreement import assert_kernel_agrees

IMAGE = np.full((4, 5, 3), 100, dtype=np.uint8)


def test_a_choice_is_a_name_whatever_else_is_given():
    assert check_choice("b", ("a", "b"), "a letter") == "b"
    for other in ("c", [], {}, np.array(["a", "b"]), None, 1):
        with pytest.raises(ValueError, match="Expected a letter among a, b, got"):
            check_choice(other, {"a": 1, "b": 2}, "a letter")


def test_images_come_out_as_uint8_or_float32():
    assert check_image(IMAGE) is IMAGE
    assert check_image(IMAGE.astype(np.float64)).dtype == np.float32
    assert check_image(np.zeros((2, 2, 3))).dtype == np.float32  # black is no 0-1 range
    with pytest.raises(ValueError, match=r"of 8x9 px \(height x width\), got 4x5"):
        check_image(IMAGE, shape=(8, 9))


@pytest.mark.parametrize(
    ("image", "error", "message"),
    [
        (IMAGE[..., 0], ValueError, "gray image"),
        (np.moveaxis(IMAGE, -1, 0), ValueError, "axis of the channels last"),
        (np.dstack([IMAGE, IMAGE[..., :1]]), ValueError, "Drop the alpha channel"),
        (IMAGE[:0], ValueError, r"shape \(H, W, 3\)"),
        (IMAGE / 255, ValueError, "looks like a 0-1 range"),
        (IMAGE - 200.0, ValueError, "within 0-255, got values from -100"),
        (np.where(IMAGE > 0, np.nan, 0.0), ValueError, "within 0-255"),
        (IMAGE.astype(np.int32), TypeError, "uint8 or float"),
        (IMAGE.astype(bool), TypeError, "uint8 or float"),
    ],
)
def test_what_is_no_image(image, error, message):
    with pytest.raises(error, match=message):
        check_image(image)


def test_gradients_say_where_the_components_belong():
    with pytest.raises(
        ValueError, match=r"\(240, 320, 2\), got \(2, 240, 320\)\. Move the axis of the components last"
    ):
        check_gradients(np.zeros((2, 240, 320)))
    with pytest.raises(ValueError, match=r"Expected gradients of shape \(3, 4, 2\), got \(4, 3, 2\)"):
        check_gradients(np.zeros((4, 3, 2)), shape=(3, 4))


@given(
    hnp.arrays(np.float64, (3, 4, 2), elements=st.floats(-2, 2)),
    st.integers(0, 23),
    st.sampled_from([np.nan, np.inf, -np.inf]),
)
def test_one_bad_value_is_refused_and_counted(gradients, index, bad):
    assert check_gradients(gradients).dtype == np.float32
    gradients.ravel()[index] = bad
    with pytest.raises(ValueError, match=r"got 1 values that are NaN or infinite.*mask="):
        check_gradients(gradients)


def test_masks_are_boolean_and_not_empty():
    with pytest.raises(TypeError, match="Convert it: mask > 0"):
        check_mask(np.full((2, 3), 255, np.uint8), shape=(2, 3))
    with pytest.raises(ValueError, match="at least one True"):
        check_mask(np.zeros((2, 3), bool), shape=(2, 3))
    with pytest.raises(ValueError, match=r"shape \(2, 3\), got \(3, 2\)"):
        check_mask(np.ones((3, 2), bool), shape=(2, 3))


def test_maps():
    with pytest.raises(ValueError, match="weights >= 0, got -1"):
        check_map(-np.ones((2, 2)), "weights", nonnegative=True)
    with pytest.raises(TypeError, match="depth_mm as numbers"):
        check_map(np.array([["a", "b"]]), "depth_mm")


def test_normals_face_the_camera():
    with pytest.raises(ValueError, match="flip the sign"):
        check_normals(np.array([0.0, 0.0, -1.0]))
    with pytest.raises(ValueError, match=r"\(\.\.\., 3\)"):
        check_normals(np.zeros((3, 2)))


def test_arrays_that_are_none():
    with pytest.raises(ValueError, match="size as an array, got a list of unequal parts"):
        as_array([[1, 2], [3]], "size")
    with pytest.raises(ValueError, match="size without masked values"):
        as_array(np.ma.masked_array([1.0, 2.0], mask=[True, False]), "size")
    assert as_array(np.ma.masked_array([1.0, 2.0]), "size").tolist() == [1.0, 2.0]


def test_values_by_their_trailing_axes():
    assert check_values(np.ones((4, 5, 3)), "light", (3,)).dtype == np.float32
    with pytest.raises(ValueError, match=r"light of shape \(..., 3\), got \(4, 5\)"):
        check_values(np.ones((4, 5)), "light", (3,))
    with pytest.raises(ValueError, match="1 values that are NaN or infinite"):
        check_values([1e300, 1.0, 1.0], "light", (3,))
    with pytest.raises(TypeError, match="light as numbers, got complex128"):
        check_values([1j, 0, 0], "light", (3,))


def test_the_range_is_that_of_numpy():
    assert_kernel_agrees(checks._range, lambda v, _: np.array([v.min(), v.max()]))
    for size, bad in itertools.product((1, 45, 4757), (np.nan, np.inf, -np.inf)):
        values = np.ones(size, np.float32)
        values[size // 2] = bad
        assert np.isnan(checks.value_range(values)).all()
    assert checks.value_range(values[:0]) == (0.0, 0.0)


def test_what_is_no_path():
    for path in ("", "a\0b", "x" * 300, "a/" * 3000):
        with pytest.raises(DataError, match="which no file can be called"):
            check_path(path)
    for path in (None, 3, b"x", ["x"]):
        with pytest.raises(TypeError, match="as text or a Path"):
            check_path(path)


def test_things_of_a_kind():
    view = View()
    assert check_is(view, View, "view") is view
    with pytest.raises(TypeError, match="Expected view as View, got NoneType"):
        check_is(None, View, "view")


def test_lists():
    assert check_list((1, 2), "images") == [1, 2]
    assert len(check_list(np.zeros((3, 2)), "images")) == 3
    with pytest.raises(TypeError, match="Expected each of names as str, got int"):
        check_list(["a", 1], "names", str)
    for values in ("text", b"bytes", 3, None, np.array(1), {}, iter([1]), object()):
        with pytest.raises(TypeError, match="Expected images as a list, got"):
            check_list(values, "images")


@pytest.mark.parametrize(
    ("given_", "pair"), [(0.1, (0.1, 0.1)), ((0.1, 0.2), (0.1, 0.2)), (np.float32(0.5), (0.5, 0.5))]
)
def test_pitch_of_square_and_other_pixels(given_, pair):
    assert check_mm_per_px(given_) == pair


@pytest.mark.parametrize(
    ("pitch", "error", "message"),
    [
        *(
            (bad, ValueError, r"mm_per_px > 0 \(mm per pixel, not pixels per mm\)")
            for bad in (0, -1, (0.1, 0), np.nan, np.inf)
        ),
        (None, ValueError, "got None"),
        ("small", TypeError, "number or"),
        ((1, 2, 3), ValueError, "shape"),
    ],
)
def test_what_is_no_pitch(pitch, error, message):
    with pytest.raises(error, match=message):
        check_mm_per_px(pitch)


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


def test_slopes_that_float32_cannot_square_are_refused():
    slopes = np.zeros((2, 3, 2), dtype=np.float32)
    slopes[1, 2, 0] = -HIGHEST_SLOPE
    check_slopes(slopes)
    slopes[1, 2, 0] *= 2
    with pytest.raises(ValueError, match=r"slopes up to 1e\+15 mm/mm, got 2\.0e\+15"):
        check_slopes(slopes)


@pytest.mark.parametrize("path", ["frame.png", Path("a") / "frame.png"])
def test_a_path_is_no_array(path):
    for check in (check_image, check_gradients, lambda path: check_values(path, "lights", (3,))):
        with pytest.raises(TypeError, match=r"got the path '.*frame\.png'.* gelform\.read_image\(path\)"):
            check(path)
