"""The check at the kernels' entry: arguments that do not fit a kernel's declaration never reach C."""

import gc

import numpy as np
import pytest

from gelform._native import Handle, Kernel, is_finite, library
from gelform._native.kernel import parameters_of, sizes_of

ZEROS = np.zeros((3, 4), np.float32)


def checked(declaration: str) -> Kernel:
    """A kernel whose arguments are checked, and which is never called: its function is not in the library."""
    return Kernel("no_such_kernel", declaration)


def refusal(declaration: str, *arguments) -> str:
    with pytest.raises((TypeError, ValueError)) as caught:
        checked(declaration)(*arguments)
    return str(caught.value)


def test_a_fitting_call_reaches_c():
    with pytest.raises(AttributeError, match="no_such_kernel"):
        checked("f32[h,w] a, f32[w] b, out f32[h,w] c, f32 d")(ZEROS, ZEROS[0], ZEROS.copy(), 1.0)


def test_refuses_wrong_dtype():
    told = refusal("f32[h,w] depth", np.zeros((3, 4)))
    assert told == "no_such_kernel: expected depth as an array of float32, got float64."
    assert "got list" in refusal("f32[h,w] depth", [[1.0]])
    assert "got NoneType" in refusal("f32[h,w] depth", None)


def test_refuses_wrong_shape():
    told = refusal("f32[h,w] a, f32[w] b", ZEROS, np.zeros(3, np.float32))
    assert told == "no_such_kernel: expected b of shape (w), h = 3, w = 4, got (3,)."
    assert "of shape (h, w, 2)" in refusal("f32[h,w,2] gradients", np.zeros((3, 4, 3), np.float32))
    assert "of shape (h, w)" in refusal("f32[h,w] a", np.zeros(4, np.float32))
    assert "count = 12" in refusal("f32[...] a, f32[...,3] b", ZEROS, np.zeros((11, 3), np.float32))
    assert "of shape (count, 3)" in refusal("f32[...,3] b", np.zeros((), np.float32))


def test_refuses_wrong_order_and_read_only_outputs():
    assert "C order" in refusal("f32[h,w] a", ZEROS.T)
    fixed = ZEROS.copy()
    fixed.flags.writeable = False
    assert "writeable" in refusal("out f32[h,w] a", fixed)


def test_refuses_what_is_not_finite():
    bad = ZEROS.copy()
    bad[1, 2] = np.inf
    assert (
        refusal("finite f32[h,w] depth", bad) == "no_such_kernel: expected finite depth, got NaN or infinity."
    )
    assert "finite" in refusal("finite f64[h,w] depth", bad.astype(np.float64))


def test_parameters_are_given_in_order_or_by_name_and_each_once():
    of_range, found = Kernel("range_f32", "f32[...] values, out f32[2] range"), np.empty(2, np.float32)
    of_range(range=found, values=np.float32([3, -1, 2]))
    assert found.tolist() == [-1, 3]
    for arguments, named in (
        ((ZEROS,), {"found": found}),
        ((), {"range": found}),
        ((ZEROS, found), {"range": found}),
    ):
        with pytest.raises(TypeError, match=r"range_f32: expected .*by name, got"):
            of_range(*arguments, **named)


def test_refuses_a_wrong_number_of_arguments_and_what_is_no_handle():
    assert "expected 2 arguments, got 1" in refusal("f32[h] a, f32 b", ZEROS[0])
    assert 'expected Handle("solver", ...), got None' in refusal("solver* prepared", None)
    with pytest.raises(AttributeError, match="no_such_handle_new"):
        Handle("no_such_handle", 3)
    gc.collect()


def test_an_optional_array_may_be_none_and_one_that_may_only_be_read_is_taken():
    fixed = ZEROS.copy()
    fixed.flags.writeable = False
    for given in ((None, ZEROS[0]), (fixed, ZEROS[0]), (np.zeros((0, 4), np.float32), ZEROS[0])):
        with pytest.raises(AttributeError):
            checked("f32[h,w]? a, f32[w] b")(*given)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [0, 15, 16, 30])
def test_finite_sees_every_place(bad, place, usable_isa, monkeypatch):
    monkeypatch.setattr("gelform._native.kernel.library", lambda _: library(usable_isa))
    values = np.full(31, 3e38, np.float32)
    assert is_finite(values)
    values[place] = bad
    assert not is_finite(values)
    assert not is_finite(np.repeat(values, 2)[::2])


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
