"""Flat punches of known height: what is read of them, and when they let the color model know the depth."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.calibration.circles.refine import refine
from gelform.calibration.draft import fit_all
from gelform.calibration.heights import (
    MOST,
    HeightJudgement,
    _share,
    face_height_mm,
    judged_by_heights,
    judgement,
)
from gelform.calibration.presses.press_set import FlatPress
from gelform.calibration.selection.candidates import Candidate
from gelform.calibration.selection.press_score import PressScore
from gelform.calibration.selection.select import Selection, worse_on_balls
from gelform.calibration.selection.trials import HeldOutPresses, Trial
from gelform.simulate import Punch, simulate_press


def tilted_disc(center, radius, height, tilt, around=6.0):
    """Depth (90, 120) of a disc whose face is tilted along x, and of gel that comes down beside it."""
    y, x = np.mgrid[:90, :120].astype(float)
    distance = np.hypot(x - center[0], y - center[1])
    face = height + tilt * np.clip(x - center[0], -radius, radius)
    return (face * np.exp(-np.maximum(distance - radius, 0) / around)).astype(np.float32)


@pytest.mark.parametrize("tilt", [0.0, 0.002])
@pytest.mark.parametrize("around", [0.5, 3.0, 6.0])
def test_the_middle_of_a_face_is_read_whatever_its_tilt_and_its_surroundings(tilt, around):
    depth = tilted_disc((70, 40), 20, 0.3, tilt, around)
    assert face_height_mm(depth) == pytest.approx(0.3, rel=0.02)


def test_a_face_that_is_cut_by_the_border_has_no_height():
    assert np.isnan(face_height_mm(tilted_disc((10, 40), 20, 0.3, 0)))
    assert np.isnan(face_height_mm(np.zeros((90, 120), np.float32)))


def test_the_share_is_what_the_heights_miss_over_what_the_terms_add():
    known, plain = np.array([0.1, 0.2, 0.3, 0.3]), np.array([0.08, 0.17, 0.25, 0.26])
    share, sigma = _share(known, plain, plain + (known - plain) / 0.6)
    assert share == pytest.approx(0.6)
    assert 0 < sigma < 0.3
    one, less_sure = _share(known[:1], plain[:1], plain[:1] + (known[:1] - plain[:1]) / 0.6)
    assert one == pytest.approx(0.6)
    assert less_sure > 2 * sigma
    aware = plain + (known - plain) / 0.6
    _, scattered = _share(known + np.array([0.03, -0.05, 0.06, -0.06]), plain, aware)
    assert scattered > 2 * sigma


def test_the_judgement_is_clear_from_two_standard_errors_on():
    heights = np.array([0.2]), np.array([0.16]), np.array([0.24])
    assert HeightJudgement(*heights, share=0.5, share_sigma=0.24).clear
    assert not HeightJudgement(*heights, share=0.5, share_sigma=0.26).clear
    beyond = HeightJudgement(*heights, share=3.0, share_sigma=0.1)
    assert beyond.used_share == MOST
    assert not beyond.clear
    assert "check height_mm" in beyond.why_not
    assert HeightJudgement(*heights, share=-1.0, share_sigma=0.1).used_share == 0
    assert HeightJudgement(*heights, share=0.5, share_sigma=0.1).percent(0.5) == pytest.approx(100)


@pytest.fixture(scope="module")
def made(sensor, presses, prepared, found, folds):
    """What a selection is made from, the selection of a `hierarchical`, and three presses of a flat punch."""
    places = [((-4.0, -2.0), 0.25), ((4.0, 2.0), 0.2), ((0.0, 0.0), 0.3)]
    flats = []
    for k, (place, depth_mm) in enumerate(places):
        rng = np.random.default_rng(k)
        press = simulate_press(sensor, Punch(4.0), depth_mm=depth_mm, center_mm=place, rng=rng)
        flats.append(FlatPress(f"flat {k}", press.image, depth_mm, f"digest {k}"))
    refined = refine(prepared, found)
    held_out = HeldOutPresses({10.0: prepared}, found, folds, [])
    plain = Candidate("hierarchical", 0.8, (("ridge", 3e-4),))
    selection = Selection(plain, (plain,) * len(folds), tuple(held_out.try_candidates([plain])))
    draft = fit_all(presses, prepared, refined, replace(plain, model="depth_aware"))
    return {10.0: prepared}, refined, held_out, selection, tuple(flats), judgement(draft, flats)


def judged(presses, made, share, named=False, **instead):
    """What punches say whose heights are those that a share of the terms reads."""
    by_offset, refined, held_out, selection, flats, read = made
    heights = read.plain_mm + share * (read.aware_mm - read.plain_mm)
    known = tuple(replace(flat, height_mm=float(height)) for flat, height in zip(flats, heights))
    selection = replace(selection, **instead) if instead else selection
    presses = replace(presses, flats=known)
    return judged_by_heights(presses, by_offset, refined, selection, held_out, named=named), known


def test_the_plain_model_stays_without_punches_and_where_it_reads_them(presses, made):
    by_offset, refined, held_out, selection, *_ = made
    same = judged_by_heights(presses, by_offset, refined, selection, held_out, named=False)
    assert same == (selection, ())
    (kept, (note,)), _ = judged(presses, made, 0.0)
    assert kept is selection
    assert "3 presses of a flat punch of known height" in note
    assert "100.0 %" in note
    assert "too unclear a difference" in note


def test_the_punches_ask_for_a_share_and_are_then_read_right(presses, made, prepared, monkeypatch):
    monkeypatch.setattr("gelform.calibration.heights.worse_on_balls", lambda *_: False)
    monkeypatch.setattr("gelform.calibration.heights.CLEAR", 0.0)
    (taken, (note,)), known = judged(presses, made, 0.7)
    assert taken.chosen.model == "depth_aware"
    assert dict(taken.chosen.settings)["share"] == pytest.approx(0.7, abs=1e-3)
    assert set(taken.by_fold) == {taken.chosen}
    assert taken.trials[-1].candidate == taken.chosen
    assert "was chosen" in note
    calibration = fit_all(presses, prepared, made[1], taken.chosen)
    reconstruct = gelform.Reconstructor(calibration, depth_sigma=False)
    read = [face_height_mm(reconstruct.from_image(flat.image).depth_mm) for flat in known]
    np.testing.assert_allclose(read, [flat.height_mm for flat in known], rtol=0.01)


def test_a_punch_with_a_steep_wall_does_not_count(sensor, presses, prepared, made):
    refined, selection, flats = made[1], made[3], made[4]
    draft = fit_all(presses, prepared, refined, replace(selection.chosen, model="depth_aware"))
    deep = simulate_press(sensor, Punch(4.0), depth_mm=0.9, rng=np.random.default_rng(5))
    steep = FlatPress("deep", deep.image, 0.9, "deep")
    assert len(judgement(draft, [*flats, steep]).known_mm) == len(flats)
    assert judgement(draft, [steep]) is None


def test_balls_that_are_read_worse_keep_the_plain_model(presses, made, monkeypatch):
    monkeypatch.setattr("gelform.calibration.heights.worse_on_balls", lambda *_: True)
    monkeypatch.setattr("gelform.calibration.heights.CLEAR", 0.0)
    (kept, (note,)), _ = judged(presses, made, 0.7)
    assert kept is made[3]
    assert "balls worse" in note


def test_a_model_that_was_asked_for_stays(presses, made):
    selection = made[3]
    (kept, (note,)), _ = judged(presses, made, 0.7, named=True)
    assert kept is selection
    assert "did not count: the color model is hierarchical" in note


def test_a_depth_aware_that_was_asked_for_gets_its_share(presses, made, monkeypatch):
    monkeypatch.setattr("gelform.calibration.heights.INFORMED", np.inf)
    aware = Candidate("depth_aware", 0.8, (("ridge", 3e-4),))
    (taken, _), _ = judged(presses, made, 0.3, named=True, chosen=aware)
    assert dict(taken.chosen.settings) == {"ridge": 3e-4, "share": pytest.approx(0.3, abs=1e-3)}


@pytest.mark.parametrize(("more", "worse"), [(0.0, False), (0.5, True), (-0.5, False)])
def test_balls_count_press_by_press(more, worse):
    rng = np.random.default_rng(0)
    plain, aware = Candidate("hierarchical", 0.8), Candidate("depth_aware", 0.8)
    caps, scatter = rng.uniform(1, 5, 20), rng.normal(0, 0.1, 20)
    before = Trial(plain, {i: PressScore(2.0, cap) for i, cap in enumerate(caps)}, {})
    scatter -= scatter.mean()
    after = Trial(
        aware, {i: PressScore(2.0, cap + more + s) for i, (cap, s) in enumerate(zip(caps, scatter))}, {}
    )
    assert worse_on_balls(after, Selection(plain, (), (before,))) == worse
