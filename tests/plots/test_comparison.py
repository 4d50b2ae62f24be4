"""Two results side by side: figures against known ones, and a picture."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.plots.comparison import compare_results, comparison_picture
from gelform.plots.result import _unit as unit_of

SHAPE = (40, 60)


def result(scale=1.0, mm_per_px=0.1):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    depth = scale * np.exp(-((x - 30) ** 2 + (y - 20) ** 2) / 50)
    slopes = gelform.gradients_from_depth(depth, mm_per_px=0.1).astype(np.float32)
    every = np.ones(SHAPE, dtype=bool)
    return gelform.Reconstruction(
        depth=depth.astype(np.float32), depth_sigma_mm=None, gradients=slopes, gradients_sigma=None,
        confidence=every.astype(np.float32), contact=depth > 0.3 * scale, known=every, mm_per_px=mm_per_px,
        curl_rms=0.01 * scale,
    )  # fmt: skip


def bare(one):
    """The same from a calibration without a scale."""
    return replace(one, depth=one.depth_px, mm_per_px=None)


def test_a_result_agrees_with_itself():
    one = compare_results(result(), result())
    assert one.unit == "mm"
    assert one.figures()["difference_rms"] == 0
    assert one.angle_deg == 0


def test_figures_of_a_scaled_copy():
    a, b = result(), result(1.2)
    found = compare_results(a, b)
    assert (found.peak_a, found.peak_b) == (pytest.approx(1.0), pytest.approx(1.2))
    assert found.difference_rms == pytest.approx(
        0.2 * np.sqrt(np.mean(a.depth_mm.astype(float) ** 2)), rel=1e-4
    )
    na, nb = a.normals[a.contact], b.normals[a.contact]
    angle = np.rad2deg(np.arccos(np.clip(np.sum(na * nb, axis=-1), -1, 1))).mean()
    assert found.angle_deg == pytest.approx(angle, rel=1e-3)
    assert found.curl_rms_b == pytest.approx(0.012)


def test_pixels_where_one_has_no_scale():
    found = compare_results(result(), bare(result(1.2)))
    assert found.unit == "px"
    assert (found.peak_a, found.peak_b) == (pytest.approx(10.0), pytest.approx(12.0))
    assert compare_results(result(mm_per_px=0.2), bare(result())).peak_a == pytest.approx(5.0)


def test_no_contact_no_angle():
    a = result()
    a = replace(a, contact=np.zeros(SHAPE, dtype=bool))
    assert compare_results(a, a).angle_deg is None


def test_different_sizes_are_refused():
    with pytest.raises(gelform.DataError, match="one size"):
        compare_results(result(), small())


def small():
    flat = np.zeros((5, 6), dtype=np.float32)
    every = flat == 0
    return gelform.Reconstruction(flat, None, np.zeros((5, 6, 2), np.float32), None, flat, every, every, 0.1)


def test_the_picture_shows_both_and_their_units():
    pytest.importorskip("matplotlib", reason="matplotlib, the extra `plots`, is not installed")
    image = np.full((*SHAPE, 3), 90, dtype=np.uint8)
    a, b = result(), result(1.2)
    drawn = comparison_picture(a, b, image, names=("first", "second"))
    assert drawn.shape[2] == 3
    assert drawn.std() > 10
    assert not np.array_equal(drawn, comparison_picture(a, a, image, names=("first", "second")))
    one = result(mm_per_px=1.0)
    in_px = comparison_picture(bare(one), bare(one), image)
    assert not np.array_equal(in_px, comparison_picture(one, one, image))
    assert not np.array_equal(gelform.picture(bare(one)), gelform.picture(one))
    assert (unit_of(bare(one)), unit_of(one)) == ("px", "mm")


@pytest.mark.filterwarnings("error")
def test_where_a_calibration_knows_nothing_it_has_no_depth():
    pytest.importorskip("matplotlib", reason="pictures need the extra 'plots'")
    a, image = result(), np.full((*SHAPE, 3), 90, dtype=np.uint8)
    unknown = replace(result(), known=np.zeros(SHAPE, dtype=bool))
    drawn, both = comparison_picture(a, unknown, image), comparison_picture(a, a, image)
    colorful = [(np.ptp(one.astype(int), axis=-1) > 60).sum() for one in (drawn, both)]
    assert colorful[0] < 0.7 * colorful[1]
    assert comparison_picture(unknown, unknown, image).shape == both.shape
