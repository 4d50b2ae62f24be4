"""Joint refinement: circles get better, what does not fit is rejected with its reason."""

from dataclasses import replace

import numpy as np

import gelform
from gelform.calibration.circles.find import find_contact
from gelform.calibration.circles.prepare import prepare
from gelform.calibration.circles.refine import refine, refining_degrees
from gelform.calibration.selection.folds import make_folds, unlike_the_others


def errors_px(contacts, simulated):
    truth = np.array([p.center_px for p in simulated.presses])
    return np.hypot(*(np.array([(c.x_px, c.y_px) for c in contacts]) - truth).T)


def test_refinement_corrects_the_circles_that_the_border_cuts(presses, simulated):
    prepared = prepare(presses, 10.0)
    found = [find_contact(press.color_change) for press in prepared]
    refined = refine(prepared, found)
    before, after = errors_px(found, simulated), errors_px(refined.contacts, simulated)
    kept = refined.accepted
    assert len(kept) >= len(prepared) - 2
    assert after[kept].mean() < 0.7 * before[kept].mean()
    assert after[kept].max() < 4.0


def test_wrong_ball_is_found_by_the_presses_that_did_not_see_it(data):
    """One real press under the name of another ball: its fold contradicts it, and nobody else."""
    presses = gelform.read_presses(data / "mini-ball")
    prepared = prepare(presses, 10.0)
    prepared[20] = replace(prepared[20], ball_radius_px=2 * prepared[20].ball_radius_px)
    found = [find_contact(press.color_change) for press in prepared]
    folds = make_folds(prepared, found, range(len(prepared)))
    odd = unlike_the_others(prepared, found, folds)
    assert list(odd) == [20]
    assert "check its ball_diameter_mm" in odd[20]
    assert refine(prepared, found, excluded=odd).reasons[20] == odd[20]


def test_double_contact_is_rejected(presses):
    """Two balls at once: the second is the colour change of another press, added far away."""
    prepared = prepare(presses, 10.0)
    shape = prepared[0].size.shape
    other = np.roll(prepared[0].color_change, (shape[0] // 4, shape[1] // 8), axis=(0, 1))
    doubled = prepared[0].color_change + other
    size = np.linalg.norm(doubled - np.median(doubled, axis=(0, 1)), axis=-1).astype(np.float32)
    prepared[0] = replace(prepared[0], color_change=doubled, size=size)
    refined = refine(prepared, [find_contact(press.color_change) for press in prepared])
    assert refined.reasons[0] is not None


def test_impossible_contact_is_rejected_and_named(presses):
    prepared = [replace(press, ball_radius_px=press.ball_radius_px / 4) for press in prepare(presses, 10.0)]
    refined = refine(prepared, [find_contact(press.color_change) for press in prepared])
    assert not refined.accepted
    assert "ball diameter or mm_per_px is wrong" in refined.reasons[0]


def test_few_presses_carry_few_terms():
    assert [refining_degrees(n) for n in (3, 6, 9)] == [(1,), (2, 1), (3, 2, 0)]
