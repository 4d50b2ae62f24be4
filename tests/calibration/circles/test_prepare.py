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
    assert [press.name for press in found[0.0]] == [press.name for press in usual]
    assert not np.array_equal(found[0.0][0].color_change, usual[0].color_change)


def test_the_edge_of_the_contacts_goes_with_the_presses(few):
    """It is measured once, in what circles are found in."""
    usual = [replace(press, contact_radius_ratio=0.7) for press in prepare(few)]
    assert {press.contact_radius_ratio for press in prepared_by_offset(few, usual, [0.0])[0.0]} == {0.7}


def test_a_circle_for_each_press_and_progress_for_each(few):
    calls = []
    found = find_contacts(prepare(few, USUAL_OFFSET), progress=lambda *call: calls.append(call[:2]))
    assert len(found) == 2
    assert calls == [(1, 2), (2, 2)]


@pytest.mark.parametrize("marked", [False, True])
def test_nothing_is_learnt_where_a_background_of_0_divides(few, marked):
    """Of the offset 0 those pixels are not usable, beside those on markers; of others all are."""
    black = few.background.copy()
    black[5, 7, 1] = 0
    spotted, free = replace(few, background=black), np.ones(few.image_shape, dtype=bool)
    free[20, 30] = not marked
    usual = prepare(few)
    with pytest.MonkeyPatch.context() as patch:
        if marked:
            patch.setattr(ColorChanges, "__call__", _marked(free))
        found = prepared_by_offset(spotted, usual, [0.0, 0.5])
    for press in found[0.0]:
        assert np.argwhere(~press.usable).tolist() == [[5, 7], *([[20, 30]] if marked else [])]
        assert np.isfinite(press.color_change).all()
        assert press.color_change[5, 7, 1] == pytest.approx(0, abs=0.05), "its neighbours', by the blur"
    for press in found[0.5]:
        assert press.usable is None if not marked else not press.usable[20, 30]
    assert found[USUAL_OFFSET] is usual


def _marked(free):
    """What `ColorChanges` gives, with markers that hide some pixels."""
    plain = ColorChanges.__call__
    return lambda self, image: (plain(self, image)[0], free)


def test_the_press_that_is_of_another_sensor_is_named(few):
    turned = replace(few.presses[1], image=np.ascontiguousarray(few.presses[1].image[::-1, ::-1]))
    with pytest.raises(gelform.CalibrationError, match=few.presses[1].name):
        prepare(replace(few, presses=(few.presses[0], turned)))
