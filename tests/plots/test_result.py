"""Pictures show what they are given where it is: depth the right way round."""

import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform.markers import MarkerFlow
from gelform.plots.result import _headline, _round_length, picture
from gelform.reconstruction import Reconstruction

pytest.importorskip("matplotlib", reason="pictures need the extra 'plots'")


def result_with_bump(row, column, *, shape=(48, 64), contact=True):
    y, x = np.mgrid[: shape[0], : shape[1]]
    depth = np.exp(-((x - column) ** 2 + (y - row) ** 2) / 20).astype(np.float32)
    slopes = np.stack(np.gradient(depth, 0.05)[::-1], axis=-1)
    return Reconstruction(
        depth=depth,
        depth_sigma_mm=None,
        gradients=slopes,
        gradients_sigma=None,
        confidence=np.ones(shape, dtype=np.float32),
        contact=(depth > 0.3) & contact,
        known=np.ones(shape, dtype=bool),
        mm_per_px=0.05,
    )


def near(image, color, tolerance=12):
    """Where the picture has a colour."""
    return np.abs(image.astype(int) - color).max(axis=-1) <= tolerance


def largest_patch(drawn):
    """(left, top, width, height) of the largest thing that is not white: the depth map."""
    boxes = cv2.connectedComponentsWithStats((drawn.min(axis=-1) < 200).astype(np.uint8))[2]
    return boxes[1 + np.argmax(boxes[1:, 4])][:4]


VIRIDIS_TOP = (253, 231, 37)


def test_the_depth_is_shown_where_it_is():
    for row, column in [(8, 8), (8, 56), (40, 8), (40, 56)]:
        drawn = picture(result_with_bump(row, column))
        left, top, width, height = largest_patch(drawn)
        rows, columns = np.nonzero(near(drawn[top : top + height, left : left + width], VIRIDIS_TOP))
        assert drawn.dtype == np.uint8
        assert np.allclose((rows.mean() / height, columns.mean() / width), (row / 48, column / 64), atol=0.03)


def test_the_image_is_shown_and_no_image_is_needed():
    result = result_with_bump(20, 30)
    magenta = np.zeros((48, 64, 3), dtype=np.uint8)
    magenta[..., [0, 2]] = 255
    assert near(picture(result, magenta), (255, 0, 255)).sum() > 10_000
    assert near(picture(result), (255, 0, 255)).sum() == 0
    with pytest.raises(ValueError, match="48x64"):
        picture(result, magenta[:-1])


def test_odd_shapes_and_an_empty_contact():
    for shape in [(24, 96), (96, 24), (2, 2)]:
        assert picture(result_with_bump(1, 1, shape=shape, contact=False)).shape[2] == 3


def test_scale_bars_are_of_round_lengths():
    for length, rounded in [
        (1, 1),
        (1.99, 1),
        (2, 2),
        (4.9, 2),
        (5.07, 5),
        (0.03, 0.02),
        (99, 50),
        (1000, 1000),
    ]:
        assert np.isclose(_round_length(length), rounded)


def test_pyplot_is_not_touched():
    picture(result_with_bump(20, 30))
    assert "matplotlib.pyplot" not in sys.modules


def test_markers_are_arrows_on_the_depth():
    rest = np.array([[20, 20], [40, 30]], dtype=np.float32)
    flow = MarkerFlow(rest, rest + 8, np.ones(2, dtype=bool), np.ones(2, np.float32), 0.05)
    bare = result_with_bump(20, 30, contact=False)
    white = []
    for one in (bare, replace(bare, markers=flow)):
        drawn = picture(one)
        left, top, width, height = largest_patch(drawn)
        white.append(np.count_nonzero(near(drawn[top : top + height, left : left + width], (255, 255, 255))))
    assert white[1] > white[0] + 100


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("mm_per_px", [0.05, None])
def test_of_a_frame_of_which_nothing_is_known_no_depth_is_drawn(mm_per_px):
    """A flat map of 0.000 mm would look as untouched gel does."""
    result = result_with_bump(20, 30)
    nowhere = np.zeros(result.shape, dtype=bool)
    flat = replace(result, depth=0 * result.depth, contact=nowhere, known=nowhere, mm_per_px=mm_per_px)
    left, top, width, height = largest_patch(picture(replace(flat, known=~nowhere)))
    inside = picture(flat)[top + 5 : top + height - 5, left + 5 : left + width - 5].astype(int)
    assert np.ptp(inside, axis=-1).max() < 60  # grey: no colour of a depth
    assert _headline(flat, 0, 0).startswith("deepest – ")


def test_what_is_not_known_is_hatched():
    result = result_with_bump(20, 30)
    known = result.known.copy()
    known[:, 48:] = False
    left, top, width, height = largest_patch(picture(result))
    drawn = picture(replace(result, known=known))[top : top + height, left : left + width]
    half = drawn[:, round(0.78 * width) :], drawn[:, : round(0.72 * width)]
    colorful = [(one.max(axis=-1) - one.min(axis=-1) > 60).mean() for one in half]
    assert colorful[0] < 0.05 < 0.8 < colorful[1]
