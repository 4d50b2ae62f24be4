"""Numbers of a result: against those of the array, written out."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform.live.measures import measures_of, outlines_of


def test_numbers_are_those_of_the_depth(result, pressed):
    found = measures_of(result)
    assert found.peak == result.depth_mm.max()
    assert result.depth_mm[found.y_px, found.x_px] == found.peak
    np.testing.assert_allclose((found.x_px, found.y_px), pressed.center_px, atol=4)
    assert found.area == pytest.approx(result.contact.sum() * result.mm_per_px**2)
    assert found.volume == pytest.approx(
        result.depth_mm[result.contact].sum() * result.mm_per_px**2, rel=1e-5
    )


def test_without_a_scale_they_are_in_pixels(result):
    bare = replace(result, mm_per_px=None)
    assert measures_of(bare).area == result.contact.sum()


def test_an_outline_goes_round_the_contact(result):
    filled = np.zeros(result.contact.shape, np.uint8)
    outlines = [np.array(outline).reshape(-1, 1, 2) for outline in outlines_of(result)]
    cv2.fillPoly(filled, outlines, 1)
    wrong = filled.astype(bool) != result.contact
    assert wrong.sum() < 0.06 * result.contact.sum()


def test_nothing_touched_has_no_outline(result):
    assert outlines_of(replace(result, contact=np.zeros_like(result.contact))) == []
