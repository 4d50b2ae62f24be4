"""Pictures show their data at the right place and depth with the right sign: a result, a comparison, an explanation."""

import sys
from dataclasses import replace
from unittest.mock import patch

import cv2
import numpy as np
import pytest

import gelform
from gelform.exchange.plots import (
    USUAL_COLOR,
    _headline_of_result,
    _round_length,
    canvas,
    compare_results,
    comparison_picture,
    deepest_px,
    draw_map,
    explanation_picture,
    picture,
    pixels_of,
    save_picture,
)
from gelform.image.markers import MarkerFlow
from gelform.result import Reconstruction
from gelform.slopes.budget import CAUSES, Explanation

pytest.importorskip("matplotlib", reason="pictures need the extra 'plots'")


def result_with_bump(row, column, *, shape=(48, 64), contact=True, mm_per_px=0.05, scale=1.0):
    y, x = np.mgrid[: shape[0], : shape[1]]
    depth = scale * np.exp(-((x - column) ** 2 + (y - row) ** 2) / 20)
    slopes = gelform.gradients_from_depth(depth, mm_per_px=0.1).astype(np.float32)
    every = np.ones(shape, dtype=bool)
    touched = (depth > 0.3 * scale) & contact
    return Reconstruction(
        depth.astype(np.float32), None, slopes, None, every.astype(np.float32), touched, every, mm_per_px
    )


def near(image, color, tolerance=12):
    """Where the picture has a color."""
    return np.abs(image.astype(int) - color).max(axis=-1) <= tolerance


def largest_patch(drawn):
    """(left, top, width, height) of the largest thing that is not white: the depth map."""
    boxes = cv2.connectedComponentsWithStats((drawn.min(axis=-1) < 200).astype(np.uint8))[2]
    return boxes[1 + np.argmax(boxes[1:, 4])][:4]


VIRIDIS_TOP = (253, 231, 37)


def test_the_depth_is_shown_where_it_is():
    for row, column in [(8, 56), (40, 8)]:
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
    for shape in [(96, 24), (2, 2)]:
        assert picture(result_with_bump(1, 1, shape=shape, contact=False)).shape[2] == 3
    assert "matplotlib.pyplot" not in sys.modules


def test_scale_bars_are_of_round_lengths():
    lengths = {1: 1, 1.99: 1, 2: 2, 4.9: 2, 5.07: 5, 0.03: 0.02, 99: 50, 1000: 1000}
    for length, rounded in lengths.items():
        assert np.isclose(_round_length(length), rounded)


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
    with patch("matplotlib.axes.Axes.quiver") as quiver:
        picture(replace(bare, markers=flow, mm_per_px=(0.05, 0.1)))
    np.testing.assert_allclose(quiver.call_args.args, [[1, 2], [2, 3], [0.4, 0.4], [0.8, 0.8]], rtol=1e-6)


@pytest.mark.filterwarnings("error")
def test_of_a_frame_of_which_nothing_is_known_no_depth_is_drawn():
    """A flat map of 0.000 mm would look as untouched gel does."""
    result = result_with_bump(20, 30)
    nowhere = np.zeros(result.shape, dtype=bool)
    flat = replace(result, depth=0 * result.depth, contact=nowhere, known=nowhere)
    left, top, width, height = largest_patch(picture(replace(flat, known=~nowhere)))
    inside = picture(flat)[top + 5 : top + height - 5, left + 5 : left + width - 5].astype(int)
    assert np.ptp(inside, axis=-1).max() < 60  # gray: no color of a depth
    assert _headline_of_result(flat, 0, 0).startswith("deepest – ")


def test_what_is_not_known_is_hatched():
    result = result_with_bump(20, 30)
    known = result.known.copy()
    known[:, 48:] = False
    left, top, width, height = largest_patch(picture(result))
    drawn = picture(replace(result, known=known))[top : top + height, left : left + width]
    half = drawn[:, round(0.78 * width) :], drawn[:, : round(0.72 * width)]
    colorful = [(one.max(axis=-1) - one.min(axis=-1) > 60).mean() for one in half]
    assert colorful[0] < 0.05 < 0.8 < colorful[1]


SHAPE = (40, 60)


def result(scale=1.0, mm_per_px=0.1):
    one = result_with_bump(20, 30, shape=SHAPE, mm_per_px=mm_per_px, scale=scale)
    return replace(one, curl_rms=0.01 * scale)


def bare(one):
    """The same from a calibration without a scale."""
    return replace(one, depth=one.depth_px, mm_per_px=None)


def test_figures_of_a_scaled_copy_of_itself_and_without_a_scale():
    a, b = result(), result(1.2)
    found, itself = compare_results(a, b), compare_results(a, a)
    assert (itself.unit, itself.figures()["difference_rms"], itself.angle_deg) == ("mm", 0, 0)
    assert (found.peak_a, found.peak_b) == (pytest.approx(1.0), pytest.approx(1.2))
    rms_mm = 0.2 * np.sqrt(np.mean(a.depth_mm.astype(float) ** 2))
    assert found.difference_rms == pytest.approx(rms_mm, rel=1e-4)
    na, nb = a.normals[a.contact], b.normals[a.contact]
    angle = np.rad2deg(np.arccos(np.clip(np.sum(na * nb, axis=-1), -1, 1))).mean()
    assert found.angle_deg == pytest.approx(angle, rel=1e-3)
    assert found.curl_rms_b == pytest.approx(0.012)
    found = compare_results(result(), bare(result(1.2)))
    assert found.unit == "px"
    assert (found.peak_a, found.peak_b) == (pytest.approx(10.0), pytest.approx(12.0))
    assert compare_results(result(mm_per_px=0.2), bare(result())).peak_a == pytest.approx(5.0)


def test_no_contact_no_angle_and_different_sizes_are_refused():
    a = result()
    nowhere = replace(a, contact=np.zeros(SHAPE, dtype=bool))
    assert compare_results(nowhere, nowhere).angle_deg is None
    with pytest.raises(gelform.DataError, match="one size"):
        compare_results(a, result_with_bump(2, 2, shape=(5, 6)))


def test_the_picture_shows_both_and_their_units():
    image = np.full((*SHAPE, 3), 90, dtype=np.uint8)
    one = result(mm_per_px=1.0)
    in_mm, in_px = comparison_picture(one, one, image), comparison_picture(bare(one), bare(one), image)
    assert in_mm.shape[2] == 3
    assert in_mm.std() > 10
    assert not np.array_equal(in_px, in_mm)
    assert not np.array_equal(comparison_picture(one, result(1.2, 1.0), image), in_mm)
    assert [_headline_of_result(a, 0, 0).split()[2] for a in (bare(one), one)] == ["px", "mm"]


@pytest.mark.filterwarnings("error")
def test_where_a_calibration_knows_nothing_it_has_no_depth():
    a, image = result(), np.full((*SHAPE, 3), 90, dtype=np.uint8)
    unknown = replace(result(), known=np.zeros(SHAPE, dtype=bool))
    drawn, both = comparison_picture(a, unknown, image), comparison_picture(a, a, image)
    colorful = [(np.ptp(one.astype(int), axis=-1) > 60).sum() for one in (drawn, both)]
    assert colorful[0] < 0.7 * colorful[1]
    assert comparison_picture(unknown, unknown, image).shape == both.shape


EXPLAINED_SHAPE = (40, 72)


def explained(*causes):
    """Of a frame in which some causes, if any, leave nothing of a patch."""
    shape = EXPLAINED_SHAPE
    sigma, patch = np.full(shape, 0.03, np.float32), np.zeros(shape, np.float32)
    patch[10:20, 30:44] = 40
    maps = {name: patch if name in causes else 0 * patch for name in CAUSES}
    sigma = np.hypot(sigma, patch if causes else 0)
    return Explanation(
        maps, np.full(shape, 0.03, np.float32), sigma, np.minimum(1, (0.04 / sigma) ** 2), 0.04
    )


def test_each_cause_that_is_there_has_a_panel_and_a_color():
    image = np.full((*EXPLAINED_SHAPE, 3), 100, np.uint8)
    without = explanation_picture(explained(), image)
    one = explanation_picture(explained("marker"), image)
    assert one.shape[0] > without.shape[0]
    assert one.shape[1] == without.shape[1]
    two = explanation_picture(explained("marker", "saturated"), image)
    right = two[two.shape[0] // 2 + 40 :, round(0.62 * two.shape[1]) :]  # the bar stands beside the last map
    assert right.min() == 255
    colors = {USUAL_COLOR, *(cause.color for cause in CAUSES.values())}
    assert len(colors) == 1 + len(CAUSES)
    with pytest.raises(ValueError, match="40x72"):
        explanation_picture(explained(), image[:8, :8])


def test_pictures_are_saved_as_they_are(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    save_picture(tmp_path / "x.png", pixels)
    assert np.array_equal(gelform.read_image(tmp_path / "x.png"), pixels)
    with pytest.raises(gelform.DataError, match="already there"):
        save_picture(tmp_path / "x.png", pixels)
    save_picture(tmp_path / "x.png", pixels, overwrite=True)


def test_without_matplotlib_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(gelform.GelformError, match=r'pip install "gelform\[plots\]"'):
        canvas(2, 2)


def test_a_map_is_drawn_pixel_by_pixel():
    figure = canvas(2, 2, layout=None)
    drawn_map = draw_map(figure.add_axes((0, 0, 1, 1)), [[0, 1], [1, 0]], "", cmap="gray")
    drawn = pixels_of(figure)
    assert drawn_map.get_array().shape == (2, 2)
    assert drawn.shape == (220, 220, 3)
    corners = drawn[[5, 5, -5, -5], [5, -5, 5, -5], 0]
    assert corners.tolist() == [0, 255, 255, 0]


def test_an_unknown_pixel_is_not_the_deepest_point():
    depth = np.zeros((30, 40), dtype=np.float32)
    depth[20, 10], depth[3, 30] = 1, 3
    assert deepest_px(depth) == (3, 30)
    depth[:, 25:] = np.nan
    assert deepest_px(depth) == (20, 10)
