"""An explanation adds up, names what matters, and tells the truth about real faults of a simulated frame."""

import numpy as np
import pytest

import gelform
from gelform.confidence.causes import CAUSES
from gelform.confidence.explanation import NAMED_FROM, explanation_of
from gelform.simulate import Ball, Punch, simulate_press
from made.seen_frames import SHAPE, patch, seen


def explained(**changes):
    frame = seen(**changes)
    variance = np.full(SHAPE, 0.03**2) + sum(cause(frame).astype(float) ** 2 for cause in CAUSES.values())
    sigma = np.sqrt(variance).astype(np.float32)
    return explanation_of(frame, sigma, np.minimum(1, (0.04 / sigma) ** 2).astype(np.float32))


def test_shares_add_up_and_the_law_is_what_is_left():
    found = explained(markers=patch())
    np.testing.assert_allclose(found.law[~patch()], 0.03, rtol=1e-4)
    assert sum(found.shares.values()) == pytest.approx(1)
    assert found.shares["marker"] == pytest.approx(patch().mean(), abs=1e-3)
    assert found.dominant[12, 35] == 1 + list(found.maps).index("marker")
    assert found.dominant[0, 0] == 0
    (finding,) = found.findings
    assert (finding.name, finding.figure) == ("marker", pytest.approx(patch().mean()))


def test_a_speck_is_not_named():
    """Of under 12 pixels that hang together."""
    eleven = patch(np.s_[10:13, 10:14])
    eleven[10, 10] = False
    assert explained(markers=eleven).findings == ()
    assert [f.name for f in explained(markers=patch(np.s_[10:13, 10:14])).findings] == ["marker"]
    assert explained().findings == ()


@pytest.fixture(scope="module")
def image(sensor):
    return simulate_press(sensor, Ball(4.0), depth_mm=0.5, rng=np.random.default_rng(8)).image


def faulty(image, name):
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    disc = np.hypot(y - 60, x - 120) < 9
    changed = image.astype(float)
    if name == "saturated":
        changed[disc] = 255
    elif name == "dark":
        changed[disc] = 0
    elif name == "shadow":
        changed[disc] *= 0.55
    elif name == "specular":
        changed[disc] *= 1.5
    elif name == "inconsistent":
        changed[70:] = 128  # torn
    elif name == "compression":
        changed += np.random.default_rng(0).normal(0, 8, changed.shape)
    return np.clip(changed, 0, 254 if name != "saturated" else 255).astype(np.uint8)


def test_the_frame_s_own_sigma_and_confidence_are_explained(calibration, image):
    reconstruct = gelform.Reconstructor(calibration)
    spotted = faulty(faulty(image, "shadow"), "compression")
    found, result = reconstruct.explain(spotted), reconstruct.from_image(spotted)
    np.testing.assert_array_equal(found.confidence, result.confidence)
    total = np.sqrt(found.law**2 + sum(np.square(one) for one in found.maps.values()))
    most = 900 * found.clean  # where several causes leave nothing, they need not be counted twice
    np.testing.assert_allclose(np.minimum(total, most), np.minimum(found.gradients_sigma, most), rtol=1e-3)


@pytest.mark.parametrize("name", ["saturated", "dark", "shadow", "specular", "inconsistent", "compression"])
def test_a_fault_is_named(calibration, image, name):
    found = gelform.Reconstructor(calibration).explain(faulty(image, name))
    assert name in {finding.name for finding in found.findings}


def test_a_press_without_a_fault_has_no_names(calibration, simulated):
    reconstruct = gelform.Reconstructor(calibration)
    for press in simulated.presses[::4]:
        assert {f.name for f in reconstruct.explain(press.image).findings} <= {"off_gamut"}


def test_an_edge_is_uncertain_and_no_fault(sensor, calibration):
    press = simulate_press(sensor, Punch(3.0), depth_mm=0.9, rng=np.random.default_rng(3))
    found = gelform.Reconstructor(calibration).explain(press.image)
    assert found.maps["wall"].max() > NAMED_FROM
    steep = np.linalg.norm(press.gradients, axis=-1) > 0.5
    assert found.maps["wall"][steep].mean() > 5 * found.maps["wall"][~steep].mean()
    assert "wall" not in {finding.name for finding in found.findings}


def test_its_figures_are_plain(calibration, image):
    figures = gelform.Reconstructor(calibration).explain(faulty(image, "shadow")).to_dict()
    assert set(figures["variance_shares"]) == {"law", *CAUSES}
    assert 0 < figures["trusted_share"] <= 1
