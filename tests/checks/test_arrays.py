"""The one door: what is let in, as what, and what is said to the rest."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gelform.checks import (
    arrays,
    as_array,
    check_gradients,
    check_image,
    check_map,
    check_mask,
    check_normals,
    check_values,
)
from kernel_agreement import assert_kernel_agrees

IMAGE = np.full((4, 5, 3), 100, dtype=np.uint8)


def test_images_come_out_as_uint8_or_float32():
    assert check_image(IMAGE) is IMAGE
    assert check_image(IMAGE.astype(np.float64)).dtype == np.float32
    assert check_image(np.zeros((2, 2, 3))).dtype == np.float32  # black is no 0-1 range


@pytest.mark.parametrize(
    ("image", "error", "message"),
    [
        (IMAGE[..., 0], ValueError, "grey image"),
        (np.moveaxis(IMAGE, -1, 0), ValueError, r"np\.moveaxis\(image, 0, -1\)"),
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


def test_image_of_another_size():
    with pytest.raises(ValueError, match=r"of 8x9 px \(height x width\), got 4x5"):
        check_image(IMAGE, shape=(8, 9))


def test_gradients_say_where_the_components_belong():
    with pytest.raises(
        ValueError, match=r"\(240, 320, 2\), got \(2, 240, 320\)\. Move the component axis last"
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


def test_infinities_of_both_signs_do_not_cancel():
    values = np.zeros((2, 3, 2))
    values[0, 0, 0], values[1, 1, 1] = np.inf, -np.inf
    with pytest.raises(ValueError, match="got 2 values"):
        check_gradients(values)


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


@pytest.mark.parametrize("shape", [(1,), (15, 3), (40, 33, 2), (71, 67)])
def test_the_range_is_that_of_numpy(shape):
    values = np.random.default_rng(0).standard_normal(shape).astype(np.float32)
    for extreme in (-7.5, 9.0):
        values.ravel()[-1] = extreme
        assert_kernel_agrees(
            arrays._range, lambda v, _: np.array([v.min(), v.max()]), values, np.zeros(2, np.float32)
        )
    for bad in (np.nan, np.inf, -np.inf):
        values.ravel()[len(values.ravel()) // 2] = bad
        assert np.isnan(arrays.value_range(values)).all()
    assert arrays.value_range(values[:0]) == (0.0, 0.0)
