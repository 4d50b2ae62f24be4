"""Color changes of presses: taken once, as each color model wants them."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.background.change import PreparedBackground
from gelform.calibration.circles.prepare import (
    USUAL_OFFSET,
    ColorChanges,
    change_settings,
    find_contacts,
    prepare,
    prepared_by_offset,
)


@pytest.fixture(scope="module")
def few(presses):
    return presses.subset([0, 3])


def test_the_change_is_that_of_the_path(few):
    settings = change_settings(few)
    change, clear = ColorChanges(few.background, settings)(few.presses[0].image)
    rest = PreparedBackground(few.background, settings)
    exposure, _ = rest.compare(few.presses[0].image)
    np.testing.assert_array_equal(change, rest.change(few.presses[0].image, exposure))
    calls = []
    (one,) = prepare(few.subset([0]), progress=lambda *call: calls.append(call[:2]))
    assert calls == [(1, 1)]
    assert one.ball_radius_px == few.presses[0].ball_diameter_mm / 2 / few.mm_per_px
    np.testing.assert_array_equal(one.color_change, change)
    np.testing.assert_allclose(
        one.size, np.linalg.norm(change - np.median(change, (0, 1)), axis=-1), atol=1e-6
    )
    assert clear is None, "a gel without markers has no pixel to leave out"


def test_the_blur_grows_with_the_image(few):
    assert change_settings(few).blur_px == pytest.approx(1.25 * few.image_shape[0] / 240)
    taller = replace(few, background=np.repeat(np.repeat(few.background, 2, 0), 2, 1))
    assert change_settings(taller).blur_px == pytest.approx(2 * change_settings(few).blur_px)


def test_each_offset_is_prepared_once(few):
    usual = prepare(few, USUAL_OFFSET)
    found = prepared_by_offset(few, usual, [USUAL_OFFSET, 0.0, 0.0])
    assert found.keys() == {USUAL_OFFSET, 0.0}
    assert found[USUAL_OFFSET] is usual
    dark = replace(few, background=np.zeros_like(few.background))
    assert prepared_by_offset(dark, usual, [0.0]).keys() == {USUAL_OFFSET}, "0/0 tells nothing"


def test_a_circle_for_each_press_and_progress_for_each(few):
    calls = []
    found = find_contacts(prepare(few, USUAL_OFFSET), progress=lambda *call: calls.append(call[:2]))
    assert len(found) == 2
    assert calls == [(1, 2), (2, 2)]


def test_nothing_is_divided_by_a_background_of_0(few):
    black = few.background.copy()
    black[0, 0] = 0
    spotted = replace(few, background=black)
    assert set(prepared_by_offset(spotted, prepare(few), [0.0, 0.5])) == {USUAL_OFFSET, 0.5}


def test_the_press_that_is_of_another_sensor_is_named(few):
    turned = replace(few.presses[1], image=np.ascontiguousarray(few.presses[1].image[::-1, ::-1]))
    with pytest.raises(gelform.CalibrationError, match=few.presses[1].name):
        prepare(replace(few, presses=(few.presses[0], turned)))
