"""The one door: what is let in, as what, and what is said to the rest."""

import itertools
from functools import partial
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
VIEW = View()
STEEP = np.zeros((2, 3, 2), dtype=np.float32)
STEEP[1, 2, 0] = -HIGHEST_SLOPE

# A check and its arguments, the class of the error, and what it says.
REFUSED = [
    *((check_choice, (odd, {"a": 1, "b": 2}, "a letter"), ValueError, "Expected a letter among a, b, got")
      for odd in ("c", [], {}, np.array(["a", "b"]), None, 1)),
    (partial(check_image, shape=(8, 9)), (IMAGE,), ValueError, r"of 8x9 px \(height x width\), got 4x5"),
    (check_image, (IMAGE[..., 0],), ValueError, "gray image"),
    (check_image, (np.moveaxis(IMAGE, -1, 0),), ValueError, "axis of the channels last"),
    (check_image, (np.dstack([IMAGE, IMAGE[..., :1]]),), ValueError, "Drop the alpha channel"),
    (check_image, (IMAGE[:0],), ValueError, r"shape \(H, W, 3\)"),
    (check_image, (IMAGE / 255,), ValueError, "looks like a 0-1 range"),
    (check_image, (IMAGE - 200.0,), ValueError, "within 0-255, got values from -100"),
    (check_image, (np.where(IMAGE > 0, np.nan, 0.0),), ValueError, "within 0-255"),
    (check_image, (IMAGE.astype(np.int32),), TypeError, "uint8 or float"),
    (check_image, (IMAGE.astype(bool),), TypeError, "uint8 or float"),
    (check_gradients, (np.zeros((2, 240, 320)),), ValueError,
     r"\(240, 320, 2\), got \(2, 240, 320\)\. Move the axis of the components last"),
    (partial(check_gradients, shape=(3, 4)), (np.zeros((4, 3, 2)),), ValueError,
     r"Expected gradients of shape \(3, 4, 2\), got \(4, 3, 2\)"),
    (check_slopes, (2 * STEEP,), ValueError, r"slopes up to 1e\+15 mm/mm, got 2\.0e\+15"),
    (partial(check_mask, shape=(2, 3)), (np.full((2, 3), 255, np.uint8),), TypeError, "Convert it: mask > 0"),
    (partial(check_mask, shape=(2, 3)), (np.zeros((2, 3), bool),), ValueError, "at least one True"),
    (partial(check_mask, shape=(2, 3)), (np.ones((3, 2), bool),), ValueError, r"shape \(2, 3\), got \(3, 2\)"),
    (partial(check_map, nonnegative=True), (-np.ones((2, 2)), "weights"), ValueError, "weights >= 0, got -1"),
    (check_map, (np.array([["a", "b"]]), "depth_mm"), TypeError, "depth_mm as numbers"),
    (check_normals, (np.array([0.0, 0.0, -1.0]),), ValueError, "flip the sign"),
    (check_normals, (np.zeros((3, 2)),), ValueError, r"\(\.\.\., 3\)"),
    (as_array, ([[1, 2], [3]], "size"), ValueError, "size as an array, got a list of unequal parts"),
    (as_array, (np.ma.masked_array([1.0, 2.0], mask=[True, False]), "size"), ValueError, "size without masked values"),
    (check_values, (np.ones((4, 5)), "light", (3,)), ValueError, r"light of shape \(..., 3\), got \(4, 5\)"),
    (check_values, ([1e300, 1.0, 1.0], "light", (3,)), ValueError, "1 values that are NaN or infinite"),
    (check_values, ([1j, 0, 0], "light", (3,)), TypeError, "light as numbers, got complex128"),
    *((check_path, (path,), DataError, "which no file can be called")
      for path in ("", "a\0b", "x" * 300, "a/" * 3000, "a\ud800b")),
    *((check_path, (path,), TypeError, "as text or a Path") for path in (None, 3, b"x", ["x"])),
    (check_is, (None, View, "view"), TypeError, "Expected view as View, got NoneType"),
    (check_list, (["a", 1], "names", str), TypeError, "Expected each of names as str, got int"),
    *((check_list, (values, "images"), TypeError, "Expected images as a list, got")
      for values in ("text", b"bytes", 3, None, np.array(1), {}, iter([1]), object())),
    *((check_mm_per_px, (bad,), ValueError, r"mm_per_px > 0 \(mm per pixel, not pixels per mm\)")
      for bad in (0, -1, (0.1, 0), np.nan, np.inf)),
    *((check_mm_per_px, (pitch,), ValueError, rf"up to 1 mm, got {pitch}. If these are pixels per mm, give 1/{pitch} = 0.0")
      for pitch in (63.4, 15.8)),
    *((check_mm_per_px, (pitch,), ValueError, "up to 1 mm, got 15.8") for pitch in ((0.05, 15.8), (15.8, 0.05))),
    (check_mm_per_px, (1e-5,), ValueError, "of at least 0.0001 mm"),
    *((check, (np.full((4, 5, size), 127, dtype), *more), TypeError, rf"{name} as numbers with a sign, got {dtype}")
      for check, name, size, more in ((check_normals, "normals", 3, ()), (check_gradients, "gradients", 2, ()))
      for dtype in ("uint8", "uint16")),
    (check_mm_per_px, (None,), ValueError, "got None"),
    (check_mm_per_px, ("small",), TypeError, "number or"),
    (check_mm_per_px, ((1, 2, 3),), ValueError, "shape"),
    (check_positive, (0, "size"), ValueError, "size > 0, got 0"),
    *((check_positive, (value, "size"), TypeError, "size as a number, got") for value in ("wide", "2", True, np.True_)),
    (check_sensor_pitch, (15.8,), ValueError, r"up to 1 mm, got 15.8. If these are pixels per mm, give 1/15.8 = 0.06329"),
    (check_sensor_pitch, (1e300,), ValueError, r"got 1e\+300.$"),
    (check_within, (6, "size", 0, 5), ValueError, "size between 0 and 5, got 6"),
    (check_within, (float("nan"), "size", 0, 5), ValueError, "size between 0 and 5, got nan"),
    *((check_within, (odd, "size", 0, 5), TypeError, "size as a number")
      for odd in ("3", True, [3], None, [[1, 2], [3]], 1j)),
    (check_numbers, ((1, 2, 3), "center", 2), ValueError, "center as 2 finite numbers"),
    (check_numbers, ((1, float("nan")), "center", 2), ValueError, "center as 2 finite numbers"),
    (check_numbers, ((1, "2"), "center", 2), TypeError, "each of center as a number, got '2'"),
    (check_numbers, (3.0, "center", 2), TypeError, "center as a list, got float"),
    (check_numbers, (np.array(3.0), "center", 2), TypeError, "center as a list, got ndarray"),
    *((check, (path, *more), TypeError, r"got the path '.*frame\.png'.* gelform\.read_image\(path\)")
      for path in ("frame.png", Path("a") / "frame.png")
      for check, more in ((check_image, ()), (check_gradients, ()), (check_values, ("lights", (3,))))),
]  # fmt: skip
# A check and its arguments, and what comes of them.
TAKEN = [
    (check_choice, ("b", ("a", "b"), "a letter"), "b"),
    (as_array, (np.ma.masked_array([1.0, 2.0]), "size"), [1.0, 2.0]),
    (check_is, (VIEW, View, "view"), VIEW),
    (check_list, ((1, 2), "images"), [1, 2]),
    (check_list, (np.arange(3), "images"), [0, 1, 2]),
    (check_mm_per_px, (0.1,), (0.1, 0.1)),
    (check_mm_per_px, ((0.1, 0.2),), (0.1, 0.2)),
    (check_mm_per_px, (np.float32(0.5),), (0.5, 0.5)),
    (check_positive, (np.float32(2), "size"), 2.0),
    (check_sensor_pitch, (0.0634,), 0.0634),
    (check_within, (3, "size", 0, 5), 3.0),
    (check_numbers, ((1, np.float32(2.5)), "center", 2), (1.0, 2.5)),
    (check_numbers, (np.array([1.0, 2.0, 3.0]), "circle", 3), (1.0, 2.0, 3.0)),
    (check_slopes, (STEEP,), None),
]


@pytest.mark.parametrize(("check", "given_", "error", "said"), REFUSED)
def test_what_is_refused_and_what_is_said(check, given_, error, said):
    with pytest.raises(error, match=said):
        check(*given_)


@pytest.mark.parametrize(("check", "given_", "wanted"), TAKEN)
def test_what_is_taken(check, given_, wanted):
    found = check(*given_)
    assert (found.tolist() if isinstance(found, np.ndarray) else found) == wanted


def test_images_come_out_as_uint8_or_float32():
    assert check_image(IMAGE) is IMAGE
    assert check_image(IMAGE.astype(np.float64)).dtype == np.float32
    assert check_image(np.zeros((2, 2, 3))).dtype == np.float32  # black is no 0-1 range
    assert check_values(np.ones((4, 5, 3)), "light", (3,)).dtype == np.float32


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


def test_the_range_is_that_of_numpy():
    assert_kernel_agrees(checks._range, lambda v, _: np.array([v.min(), v.max()]))
    for size, bad in itertools.product((1, 45, 4757), (np.nan, np.inf, -np.inf)):
        values = np.ones(size, np.float32)
        values[size // 2] = bad
        assert np.isnan(checks.value_range(values)).all()
    assert checks.value_range(values[:0]) == (0.0, 0.0)
