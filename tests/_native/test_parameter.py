"""A kernel's parameters: what a declaration says, and what is refused before C sees it."""

import numpy as np
import pytest

from gelform._native.parameter import is_finite, parameters_of, sizes_of

DECLARATION = "finite f32[h,w,3] image, u8[h,w]? mask, out f32[...,2] slopes, grid* grid, f32 factor"


def test_a_declaration_is_read():
    image, mask, slopes, grid, factor = parameters_of(DECLARATION)
    assert (image.role, image.kind, image.axes, image.optional) == ("finite", "f32", ("h", "w", "3"), False)
    assert mask.optional
    assert slopes.axes == ("...", "2")
    assert [one.is_handle for one in (image, grid, factor)] == [False, True, False]
    assert sizes_of((image, mask, slopes, grid, factor)) == ("h", "w", "count")


@pytest.mark.parametrize("text", ["f31[h] a", "f32[h]", "f32 [h] a", "in f32[h] a", ""])
def test_what_is_no_declaration_is_refused(text):
    with pytest.raises(ValueError, match="Expected a parameter such as"):
        parameters_of(text)


def test_arrays_that_c_cannot_take_are_refused():
    image, mask, slopes, *_ = parameters_of(DECLARATION)
    good = np.zeros((4, 5, 3), dtype=np.float32)
    frozen, hole = np.zeros((4, 2), dtype=np.float32), good.copy()
    frozen.flags.writeable, hole[1, 2, 0] = False, np.nan
    for parameter, array, text in (
        (image, good.astype(float), "array of float32, got float64"),
        (image, [1.0], "got list"),
        (image, None, "got NoneType"),
        (image, good.transpose(1, 0, 2), "in C order"),
        (image, hole, "expected finite image"),
        (slopes, frozen, "to be writeable"),
    ):
        with pytest.raises((TypeError, ValueError), match=text):
            parameter.pointer(array)
    assert mask.pointer(None) is None
    assert image.pointer(good) is not None


def test_shapes_have_to_agree_with_each_other():
    image, mask, slopes, *_ = parameters_of(DECLARATION)
    sizes = {}
    image.match_axes((4, 5, 3), sizes)
    mask.match_axes((4, 5), sizes)
    slopes.match_axes((2, 7, 2), sizes)
    assert sizes == {"h": 4, "w": 5, "count": 14}
    for parameter, shape in ((mask, (5, 4)), (image, (4, 5, 4)), (mask, (4, 5, 1)), (slopes, (14, 3))):
        with pytest.raises(ValueError, match=f"expected {parameter.name} of shape"):
            parameter.match_axes(shape, dict(sizes))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_finite_is_finite_wherever_the_hole_is(dtype):
    values = np.ones(1000, dtype=dtype)
    assert is_finite(values)
    for at in (0, 500, 999):
        for bad in (np.nan, np.inf, -np.inf):
            values[at] = bad
            assert not is_finite(values)
            values[at] = 1
