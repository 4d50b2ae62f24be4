"""What is kept of a result, and what the table says of it."""

import numpy as np
import pytest

import gelform
from gelform.batch.outputs.maps import attributes_of, blank_maps, check_names, facts_of, maps_of
from gelform.batch.settings import KEPT, BatchSettings
from gelform.errors import DataError
from made.small_gel import MM_PER_PX, SHAPE, Touch, depth_of


@pytest.fixture(scope="module")
def result(cal, images):
    return gelform.Reconstructor(cal).from_image(images[3])


@pytest.mark.parametrize("settings", [BatchSettings(keep=KEPT), BatchSettings("zarr", dtype="uint16")])
def test_blank_maps_are_of_the_same_kind(result, settings):
    maps, blank = maps_of(result, settings), blank_maps(settings, SHAPE)
    assert [(n, m.shape, m.dtype) for n, m in maps.items()] == [
        (n, m.shape, m.dtype) for n, m in blank.items()
    ]


def test_levels_turn_into_mm_by_their_attributes(result):
    settings = BatchSettings("zarr", dtype="uint16")
    told, levels = attributes_of("depth_mm", settings), maps_of(result, settings)["depth_mm"]
    depth = levels[result.known] * told["scale_factor"] + told["add_offset"]
    assert np.abs(depth - result.depth_mm[result.known]).max() <= 0.51e-4


def test_a_map_that_is_not_there_is_said(cal, images):
    without = gelform.Reconstructor(cal, depth_sigma=False).from_image(images[0])
    with pytest.raises(DataError, match="gives no depth_sigma_mm"):
        maps_of(without, BatchSettings(keep=("depth_sigma",)))


def test_figures_of_a_ball(result):
    """Against the true depth, over the contact that was found."""
    facts, touch = facts_of(result), Touch(depth_mm=0.35)
    truth = depth_of(touch)
    assert facts["contacts"] == 1
    assert facts["health"] == ""
    assert facts["deepest_mm"] == pytest.approx(truth.max(), abs=0.02)
    assert (facts["deepest_x_px"], facts["deepest_y_px"]) == pytest.approx((touch.x_px, touch.y_px), abs=4)
    assert facts["volume_mm3"] == pytest.approx(truth[result.contact].sum() * MM_PER_PX**2, rel=0.03)
    assert facts["contact_mm2"] == pytest.approx(result.contact.sum() * MM_PER_PX**2)


def test_a_folder_called_like_an_array_is_refused():
    check_names(["depth_mm"], BatchSettings())
    with pytest.raises(DataError, match="where an array known does"):
        check_names(["day1", "day2/known"], BatchSettings("zarr"))
