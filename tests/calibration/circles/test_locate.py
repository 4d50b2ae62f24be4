"""A ball of another size than stated: the sentence says how many times as large, where nearly all presses fit it."""

import re
from dataclasses import replace

import pytest

from gelform.calibration.circles import locate as module
from gelform.calibration.circles.locate import (
    BALL_FACTORS,
    NEARLY_ALL,
    Refined,
    mark_notes,
    other_ball_note,
    refine,
)
from gelform.calibration.circles.prepare import find_contacts
from gelform.calibration.circles.refine import why_impossible

BALL_PX = 40.0


def stated(prepared, factor):
    return [replace(press, ball_radius_px=factor * press.ball_radius_px) for press in prepared]


@pytest.mark.slow
def test_a_ball_that_is_stated_half_as_large_is_named(prepared, found):
    """All presses are refused, and taken with the ball that the sentence names."""
    small = stated(prepared, 0.5)
    refined = refine(small, found)
    assert not refined.accepted
    note = other_ball_note(small, found, refined)
    said = re.match(r"(\d+) of (\d+) presses fit a ball ([\d.]+) times as large as stated", note)
    count, of, factor = (float(one) for one in said.groups())
    assert "Check ball_diameter_mm and mm_per_px" in note
    assert factor > 1.25
    assert of == len(prepared)
    named = BALL_FACTORS[abs(BALL_FACTORS - factor).argmin()]
    assert len(refine(stated(small, named), found).accepted) == count >= NEARLY_ALL * len(prepared)


def test_of_the_right_ball_nothing_is_said(prepared, found, monkeypatch):
    """Nor is another one looked for."""
    refined = refine(prepared, found)
    monkeypatch.setattr(module, "refine", None)
    assert other_ball_note(prepared, found, refined) is None


def test_circles_by_hand_of_other_places_and_sizes_are_named(prepared, found):
    circles = [contact.circle_px for contact in found[:6]]
    right = [replace(press, mark=circle) for press, circle in zip(prepared, circles)]
    assert mark_notes(right, find_contacts(right)) == ()
    swapped = [replace(right[0], mark=circles[1]), replace(right[1], mark=circles[0]), *right[2:]]
    (note,) = mark_notes(swapped, contacts := find_contacts(swapped))
    assert note.count("radii)") == 2
    assert prepared[0].name in note
    assert contacts[0].circle_px == pytest.approx(circles[0]), "as without"
    wide = [replace(press, mark=(x, y, 2 * radius)) for press, (x, y, radius) in zip(prepared, circles)]
    (note,) = mark_notes(wide, find_contacts(wide))
    assert "was the diameter given?" in note
    x, y, radius = circles[0]
    beyond = replace(prepared[0], mark=(x + 500, y, radius))
    assert "lies outside the image of 176 px by 132 px" in why_impossible(beyond, found[0])
    assert why_impossible(right[0], found[0]) is None


class Judged:
    """Refinement of ten presses and their agreement, given by how many times as large the ball is as at first."""

    def __init__(self, press, contact, accepted, error):
        self.presses, self.contacts, self.accepted, self.error = (
            [press] * 10,
            (contact,) * 10,
            accepted,
            error,
        )

    def refine(self, presses, found):
        refused = 10 - self.accepted(presses[0].ball_radius_px / self.presses[0].ball_radius_px)
        reasons = ("too wide",) * refused + (None,) * (10 - refused)
        return Refined(tuple(found), reasons[-len(presses) :], "model")

    def agreement(self, press, contact, model):
        assert model == "model"
        return self.error(press.ball_radius_px / self.presses[0].ball_radius_px), 1.0

    def note(self, monkeypatch, excluded=()):
        for name in ("refine", "agreement"):
            monkeypatch.setattr(module, name, getattr(self, name))
        refined = self.refine(self.presses, self.contacts)
        return other_ball_note(self.presses, self.contacts, refined, excluded)


@pytest.fixture
def judged(prepared, found):
    return lambda accepted, error: Judged(prepared[0], found[0], accepted, error)


def best_at(factor):
    """Errors that are least, over the slopes, for a ball so many times as large: those of larger balls are gentler."""
    return lambda tried: 0.01 * (3 + abs(tried - factor)) / tried


@pytest.mark.parametrize("factor", [BALL_FACTORS[3], BALL_FACTORS[13], BALL_FACTORS[-1]])
def test_of_all_that_fit_the_best_one_is_named(judged, monkeypatch, factor):
    note = judged(lambda tried: 0 if tried == 1 else 10, best_at(factor)).note(monkeypatch)
    assert note.startswith(f"10 of 10 presses fit a ball {factor:.2f} times as large as stated")


def test_the_best_has_to_fit_nearly_all(judged, monkeypatch):
    """One that eight of ten fit is passed over, however well they do."""
    better, good = BALL_FACTORS[15], BALL_FACTORS[13]
    counts = {better: 8, good: 9}
    note = judged(
        lambda tried: counts.get(min(BALL_FACTORS, key=lambda f: abs(f - tried)), 0), best_at(better)
    )
    assert note.note(monkeypatch).startswith(f"9 of 10 presses fit a ball {good:.2f} times")


def test_a_ball_that_hardly_differs_is_the_stated_one_and_one_that_fits_none_no_other(judged, monkeypatch):
    """A step of the sweep either way: what is wrong is something else."""
    for factor in BALL_FACTORS[9:12]:
        assert judged(lambda tried: 0 if tried == 1 else 10, best_at(factor)).note(monkeypatch) is None
    assert judged(lambda tried: 0, best_at(1.5)).note(monkeypatch) is None


@pytest.mark.parametrize(("refused", "said"), [(2, False), (3, True)])
def test_some_presses_are_always_refused(judged, monkeypatch, refused, said):
    note = judged(lambda tried: 10 - refused if abs(tried - 1) < 0.01 else 10, best_at(1.5)).note(monkeypatch)
    assert (note is not None) == said


def test_presses_that_were_refused_before_do_not_count(judged, monkeypatch):
    """The same image listed twice is refused with any ball: it neither asks for another one nor speaks for it."""
    twice = judged(lambda tried: 5 if abs(tried - 1) < 0.01 else 10, best_at(1.5))
    assert twice.note(monkeypatch, excluded=range(5)) is None
    three_of_five = judged(lambda tried: 2 if abs(tried - 1) < 0.01 else 10, best_at(BALL_FACTORS[16]))
    assert three_of_five.note(monkeypatch, excluded=range(5)).startswith("5 of 5 presses fit")
