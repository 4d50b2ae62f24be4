"""An explanation adds up, names what matters, and tells the truth about faults of simulated frames."""

import re
from dataclasses import replace

import numpy as np
import pytest

import gelform
from confidence import faults
from gelform.cli import options
from gelform.cli.commands.inspection import explain
from gelform.exchange.plots import explanation_picture
from gelform.live.shown import ShownFrame
from gelform.simulate import Ball, Punch, simulate_press
from gelform.slopes.budget import (
    CAUSES,
    LEAST_WEIGHT,
    Budget,
    Cause,
    ExplainedFrame,
    Explanation,
    explanation_of,
    names_in_budget,
)
from made.images import PATCHED as SHAPE
from made.images import patch


def explained(**causes):
    """Of a frame whose law says 0.03, and some causes what they are given (H, W)."""
    maps = {name: np.asarray(causes.get(name, 0) * np.ones(SHAPE), np.float32) for name in CAUSES}
    sigma = np.sqrt(0.03**2 + sum(np.square(one.astype(float)) for one in maps.values())).astype(np.float32)
    confidence = np.minimum(1, (0.04 / sigma) ** 2).astype(np.float32)
    return Explanation(maps, np.full(SHAPE, 0.03, np.float32), sigma, confidence, 0.04)


def test_shares_add_up_and_the_law_is_what_is_left():
    found = explained(marker=40 * patch(), wall=0.04 * patch(np.s_[30:, :]))
    np.testing.assert_allclose(found.law[~patch()], 0.03, rtol=1e-4)
    assert sum(found.shares.values()) == pytest.approx(1)
    assert found.shares["marker"] == pytest.approx(patch().mean(), abs=1e-3)
    assert found.shares["wall"] == pytest.approx(0.25 * 0.04**2 / (0.03**2 + 0.04**2), rel=1e-3)
    assert found.dominant[12, 35] == 1 + list(found.maps).index("marker")
    assert found.dominant[35, 0] == 1 + list(found.maps).index("wall")
    assert found.dominant[0, 0] == 0
    (finding,) = found.findings
    assert (finding.name, finding.figure) == ("marker", pytest.approx(patch().mean()))


GRAY = np.full((*SHAPE, 3), 100, np.uint8)
UNSEEN_SIGMA = 0.04 / LEAST_WEIGHT**0.5


def shown_as(image=GRAY, color=(0.0, 0.0, 0.0), outliers=0.0, **frame):
    """The maps of a frame whose law says 0.03, with other rows as given."""
    hidden = [frame[name] for name in ("markers", "lost", "outside") if name in frame]
    clipped = frame.get("clipped")
    if clipped is not None:
        hidden.append(clipped.sum(axis=-1) > 1)
    unseen = np.any(hidden, axis=0) if hidden else np.zeros(SHAPE, bool)
    rows = {name: np.zeros(SHAPE, np.float32) for name in names_in_budget()[1]}
    rows["law"] += np.float32(0.03)
    rows["outlier"] += np.float32(outliers)
    rows["unseen"] += np.float32(UNSEEN_SIGMA) * unseen
    read = np.sqrt(sum(np.square(one) for one in rows.values()))
    budget = Budget(read, read, rows["steep"], read, np.ones(SHAPE, np.float32), rows)
    usual = dict.fromkeys(("clipped", "markers", "lost", "outside"))
    change = np.broadcast_to(np.float32(color), GRAY.shape)
    return explanation_of(
        ExplainedFrame(budget, 0.04, pixels=image, color_change=change, blur_px=1.25, **{**usual, **frame})
    )


def there(found):
    return {name for name, one in found.maps.items() if one.any()}


def test_every_cause_has_its_map_in_the_order_that_pictures_color_them():
    found = shown_as()
    assert list(found.maps) == list(CAUSES)
    assert there(found) == set()
    np.testing.assert_allclose(found.law, 0.03, rtol=1e-5)


def test_a_cause_is_one_row_and_its_variance(monkeypatch, reconstruct):
    """Figures, findings, pictures, the page and the command follow; what has no function is a row of the kernel."""
    of_kernel = {name for name, cause in CAUSES.items() if cause.of is None}
    assert {*of_kernel, "law", "outlier", "unseen"} == set(names_in_budget()[1])
    assert tuple(CAUSES) == options.CAUSES
    assert all(re.search(rf"\b{name}\b", explain.__doc__) for name in CAUSES)
    dusty = Cause("dusty.", 0.35, "#123456", lambda frame: frame.hidden(patch()))
    monkeypatch.setitem(CAUSES, "dust", dusty)
    found = shown_as(outside=patch())
    assert list(found.maps) == list(found.to_dict()["variance_shares"])[1:] == list(CAUSES)
    np.testing.assert_allclose(found.maps["dust"], UNSEEN_SIGMA * patch(), rtol=1e-6)
    assert "dusty." in found.findings[-1].message
    assert found.to_dict()["findings"][-1]["name"] == "dust"
    found.maps["outside"][...] = 0
    assert (found.dominant[patch()] == len(CAUSES)).all()
    picture = explanation_picture(found, GRAY)
    assert (picture == (0x12, 0x34, 0x56)).all(axis=-1).sum() > 100
    frame = gelform.Frame(GRAY, 0.0, 0, 0)
    page = ShownFrame(0, frame, GRAY, reconstruct.from_image(reconstruct.background), explain=lambda: found)
    header, (plane,) = page.header(), page.planes(["causes"], "raw")
    assert (header["causes"][-1], header["cause_colors"][-1]) == ("dust", "#123456")
    bits = np.frombuffer(plane.data, np.uint16)
    assert np.array_equal((bits >> (len(CAUSES) - 1)) > 0, patch().ravel())


@pytest.mark.parametrize(
    ("color", "kind"),
    [
        ((-0.4, -0.3, -0.35), "shadow"),
        ((-0.5, 0.0, 0.0), "shadow"),  # of one light
        ((0.9, 0.7, 0.8), "specular"),
        ((0.8, -0.6, -0.5), "off_gamut"),
        ((0.4, -0.4, 0.1), "off_gamut"),
    ],
)
def test_what_the_color_change_has_in_common_names_an_outlier(color, kind):
    found = shown_as(color=color, outliers=5.0 * patch())
    assert there(found) == {kind}
    np.testing.assert_allclose(found.maps[kind], 5.0 * patch())


def test_what_markers_hide_and_what_is_not_lit():
    found = shown_as(markers=patch(), outside=patch(np.s_[:12, :9]))
    assert there(found) == {"marker", "outside"}
    np.testing.assert_allclose(found.maps["marker"], UNSEEN_SIGMA * patch(), rtol=1e-6)
    np.testing.assert_array_equal(found.maps["outside"] > 0, patch(np.s_[:12, :9]))
    assert (found.law[~patch()] < 0.04).all()


@pytest.mark.parametrize(("level", "name"), [(254, "saturated"), (0, "dark"), (2, "dark")])
def test_a_channel_that_is_left_out_costs_what_the_others_do_not_say(level, name):
    image, clipped = GRAY.copy(), np.zeros((*SHAPE, 3), np.uint8)
    image[patch(), 1], clipped[patch(), 1] = level, 1
    clipped[patch(np.s_[10:20, 30:34])] = 1
    found = shown_as(image, clipped=clipped)
    assert there(found) == {name}
    np.testing.assert_allclose(found.maps[name][10:20, 30:34], UNSEEN_SIGMA, rtol=1e-6)
    np.testing.assert_allclose(found.maps[name][10:20, 34:44], 0.03, rtol=1e-4)
    assert not found.maps[name][~patch()].any()


def test_a_pixel_is_saturated_or_dark_not_both():
    image, clipped = GRAY.copy(), np.zeros((*SHAPE, 3), np.uint8)
    image[20, 30], image[20, 60] = (0, 100, 255), (0, 0, 0)
    saturated, dark = patch(np.s_[18:23, 28:33]), patch(np.s_[18:23, 58:63])
    clipped[saturated | dark] = 1
    found = shown_as(image, clipped=clipped)
    np.testing.assert_array_equal(found.maps["saturated"] > 0, saturated)
    np.testing.assert_array_equal(found.maps["dark"] > 0, dark)


@pytest.mark.parametrize(
    ("level", "name"),
    [(255, "saturated"), (240, "saturated"), (239, "inconsistent"), (17, "inconsistent"), (16, "dark"), (0, "dark")],
)  # fmt: skip
def test_a_lost_part_is_named_by_how_bright_it_was(level, name):
    came = GRAY.copy()
    came[:, 30:] = level
    lost = patch(np.s_[:, 48:])
    found = shown_as(came, lost=lost)
    assert there(found) == {name}
    np.testing.assert_allclose(found.maps[name], UNSEEN_SIGMA * lost, rtol=1e-6)


def test_a_speck_is_not_named():
    """Of under 12 pixels that hang together."""
    eleven = patch(np.s_[10:13, 10:14])
    eleven[10, 10] = False
    assert explained(marker=40 * eleven).findings == ()
    assert [f.name for f in explained(marker=40 * patch(np.s_[10:13, 10:14])).findings] == ["marker"]
    assert explained().findings == ()


@pytest.mark.parametrize("name", CAUSES)
def test_what_adds_enough_is_named(name):
    limit = CAUSES[name].named_from
    assert explained(**{name: limit * patch()}).findings == ()
    findings = explained(**{name: (1.01 * limit + 1e-6) * patch()}).findings
    assert [finding.name for finding in findings] == [name] * (CAUSES[name].sentence != "")
    assert all(CAUSES[name].sentence in finding.message for finding in findings)


@pytest.fixture(scope="module")
def image(sensor):
    return simulate_press(sensor, Ball(4.0), depth_mm=0.5, rng=np.random.default_rng(8)).image


@pytest.fixture(scope="module")
def reconstruct(calibration):
    return gelform.Reconstructor(calibration)


def test_the_frame_s_own_sigma_and_confidence_are_explained(reconstruct, image):
    rng = np.random.default_rng(3)
    spotted = image
    for name in ("shadow", "saturated", "off_gamut"):
        spotted = faults.FAULTS[name](spotted, rng)
    noise = rng.normal(0, 4, image.shape)
    spotted = np.where(spotted < 254, np.clip(spotted + noise, 5, 250), 255).astype(np.uint8)
    found, result = reconstruct.explain(spotted), reconstruct.from_image(spotted)
    np.testing.assert_array_equal(found.confidence, result.confidence)
    total = np.sqrt(found.law**2 + sum(np.square(one) for one in found.maps.values()))
    np.testing.assert_allclose(total, found.gradients_sigma, rtol=1e-3)
    assert list(found.maps) == list(CAUSES)
    assert {"saturated", "shadow", "compression"} <= {finding.name for finding in found.findings}


def faulty_frames(image, name):
    """Three frames with a fault of more than 0.5 % of the pixels, and those that it spoils: by compression, all."""
    found = []
    for seed in range(20):
        faulty = faults.FAULTS[name](image, np.random.default_rng(seed))
        spoilt = np.abs(faulty.astype(int) - image).max(axis=-1) > (40 if name != "compression" else -1)
        if spoilt.mean() > 0.005:
            found.append((faulty, spoilt))
    return found[:3]


@pytest.mark.parametrize("name", faults.FAULTS)
def test_a_fault_is_named_and_not_trusted(reconstruct, image, name):
    """And its figures are plain."""
    for faulty, spoilt in faulty_frames(image, name):
        found = reconstruct.explain(faulty)
        assert name in {finding.name for finding in found.findings}
        figures = found.to_dict()
        assert set(figures["variance_shares"]) == {"law", *CAUSES}
        assert 0 < figures["trusted_share"] <= 1
        assert (found.maps[name][spoilt] > CAUSES[name].named_from).mean() > 0.2
        assert (found.confidence[spoilt] > 0.5).mean() < (0.85 if name == "compression" else 0.02)


def test_a_press_without_a_fault_has_no_names(reconstruct, simulated):
    """But for a few pixels at a steep rim, beyond the upper quartile of the slopes that all presses have shown."""
    for press in simulated.presses[::4]:
        findings = reconstruct.explain(press.image).findings
        assert [one.name for one in findings if one.name != "steep" or one.figure > 0.002] == []


def test_an_edge_is_uncertain_and_no_fault(sensor, reconstruct):
    press = simulate_press(sensor, Punch(3.0), depth_mm=0.9, rng=np.random.default_rng(3))
    found = reconstruct.explain(press.image)
    assert found.maps["wall"].max() > CAUSES["wall"].named_from
    steep = np.linalg.norm(press.gradients, axis=-1) > 0.5
    assert found.maps["wall"][steep].mean() > 5 * found.maps["wall"][~steep].mean()
    assert "wall" not in {finding.name for finding in found.findings}


@pytest.mark.parametrize("step", ["none", "no response"])
def test_without_a_step_no_color_is_that_of_no_slope(calibration, image, step):
    forward = replace(calibration.forward, step_sigma=None) if step == "none" else None
    plain = gelform.Reconstructor(replace(calibration, forward=forward))
    for name in ("shadow", "specular", "off_gamut"):
        found = plain.explain(faults.FAULTS[name](image, np.random.default_rng(0)))
        assert not any(found.maps[one].any() for one in ("shadow", "specular", "off_gamut"))
