"""Candidates: what a color model's class says is what is tried, in the order of complexity."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.selection.candidates import (
    DEFAULT_ZONE,
    ZONES,
    Candidate,
    Start,
    candidates_for,
    candidates_from,
    color_model_names,
    zone_judge,
)
from gelform.color_models import COLOR_MODELS, HierarchicalModel, Variant
from made.color_samples import ball_samples, lambertian_change


def described(color_model, presses):
    return [candidate.describe() for candidate in candidates_for(color_model, presses)]


def test_few_presses_try_few_terms():
    assert described("auto", 6) == [
        "lambertian, zone 0.8",
        "polynomial 1, zone 0.8",
        "hierarchical ridge 0.001, zone 0.8",
        "hierarchical ridge 0.0003, zone 0.8",
    ]


def test_many_presses_try_more():
    assert described("auto", 60) == [
        "lambertian, zone 0.8",
        "near_light, zone 0.8",
        "polynomial 1, zone 0.8",
        "hierarchical ridge 0.0003, zone 0.8",
        "hierarchical ridge 0.0001, zone 0.8",
        "polynomial 5-4-3, zone 0.8",
    ]
    assert described("auto", 20)[-1] == "polynomial 4-3-1, zone 0.8"


@pytest.mark.parametrize("presses", [2, 3, 6, 12, 17, 18, 29, 30, 100])
@pytest.mark.parametrize("name", ["auto", *COLOR_MODELS])
def test_something_is_always_tried(name, presses):
    candidates = candidates_for(name, presses)
    assert candidates
    assert name == "auto" or {c.model for c in candidates} == {name}
    assert zone_judge(presses).model == "polynomial"


def test_slow_models_are_tried_by_name_only():
    slow = {name for name, model in COLOR_MODELS.items() if model.slow}
    assert slow == {"interpolation", "lookup", "mlp"}
    assert not slow & {c.model for c in candidates_for("auto", 100)}


def test_the_class_says_what_is_tried(monkeypatch):
    """A model of one's own: between the others by its complexity, what it keeps out of auto by name only."""

    class Mine:
        name, change_offset, slow = "mine", 10.0, False

        @classmethod
        def variants(cls, presses):
            return [Variant(10.0, {"strength": 2}), Variant(1e9, {"strength": presses}, in_auto=False)]

    monkeypatch.setitem(COLOR_MODELS, "mine", Mine)
    assert described("mine", 40) == ["mine strength 2, zone 0.8", "mine strength 40, zone 0.8"]
    assert [name.split(",")[0] for name in described("auto", 40)][3:5] == [
        "mine strength 2",
        "hierarchical ridge 0.0003",
    ]
    assert color_model_names()[-1] == "mine"
    monkeypatch.setattr(Mine, "slow", True)
    assert "mine" not in {c.model for c in candidates_for("auto", 40)}


def test_unknown_models_are_refused_with_the_names_of_all():
    with pytest.raises(ValueError, match=r"auto, lambertian, .*lookup, got 'best'"):
        candidates_for("best", 10)


def test_another_units_model_is_followed_less_and_less():
    start = Start(None, "digest", 0.7)
    ridges = [dict(c.settings)["ridge"] for c in candidates_from(start)]
    assert ridges == sorted(ridges, reverse=True)
    assert {c.start for c in candidates_from(start)} == {start}
    assert {c.zone for c in candidates_from(start)} == {0.7}


def test_a_fit_begins_at_the_other_units_model_where_there_is_one():
    """Slopes of which the other unit's model reads half: followed closely, and not at all."""
    samples = ball_samples(lambertian_change)
    whole = HierarchicalModel.fit(samples)
    start = Start(replace(whole, nodes=0.5 * whole.nodes), "digest", 0.7)
    held = replace(candidates_from(start)[0], settings=(("ridge", 1e6),)).fit_samples(samples)
    np.testing.assert_allclose(held.nodes, start.model.nodes, atol=1e-3)
    alone = candidates_for("hierarchical", 6)[0].fit_samples(samples)
    ratio = np.vdot(alone.nodes, whole.nodes) / np.vdot(whole.nodes, whole.nodes)
    assert ratio == pytest.approx(1, abs=0.05)


def test_zones_are_parts_of_the_contact_and_a_fine_polynomial_judges_them():
    assert list(ZONES) == sorted(ZONES)
    assert DEFAULT_ZONE in ZONES
    assert ZONES[0] > 0.5
    assert ZONES[-1] < 1
    assert zone_judge(100) == zone_judge(18) != zone_judge(17)


def test_a_model_that_asks_gets_the_depth_that_a_plain_one_reads(prepared, found):
    some = range(0, len(prepared), 2)
    presses, circles = [prepared[i] for i in some], [found[i] for i in some]
    samples = Candidate("depth_aware", 0.8).samples(presses, circles, total=3000)
    inside = samples.gradients.any(axis=1)
    assert samples.depth_px[inside].mean() > 5 * samples.depth_px[~inside].mean() >= 0
    assert Candidate("hierarchical", 0.8).samples(presses, circles, total=3000).depth_px is None
