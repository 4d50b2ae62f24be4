"""The slopes' standard deviation: recovered from errors of known spread, and what it makes of a frame."""

from dataclasses import asdict

import numpy as np
import pytest

from gelform.color_models._shared.gamut import Gamut
from gelform.confidence import SlopeErrors, SlopeSigma

LAW = SlopeSigma(rest=0.01, slopes=(0.0, 0.5, 1.0), sigmas=(0.02, 0.05, 0.12), clean=0.03, correlation_px=8.0)


def errors_by(law, place=lambda x, y: 1.0, rest: float = 0.01, count: int = 60_000):
    """Errors whose spread is law(|g|) times place(x, y), on 40 presses."""
    rng = np.random.default_rng(0)
    slopes, x, y = rng.uniform(0, 0.8, count), rng.uniform(0, 1, count), rng.uniform(0, 1, count)
    spread = law(slopes) * place(x, y)
    press = rng.integers(0, 40, count)
    return SlopeErrors(
        slopes,
        spread[:, None] * rng.standard_normal((count, 2)),
        x,
        y,
        press,
        rest * rng.standard_normal((5000, 2)),
    )


def shares_within(sigma, held_out, bins):
    within = np.abs(held_out.errors) < sigma.of(held_out.slopes, held_out.x, held_out.y)[:, None]
    return [within[bins == b].mean() for b in np.unique(bins)]


@pytest.mark.parametrize(("floor", "growth"), [(0.02, 0.0), (0.02, 0.1), (0.005, 0.2)])
def test_law_is_recovered(floor, growth):
    def law(slopes):
        return np.sqrt(floor**2 + (growth * slopes) ** 2)

    held_out = errors_by(law)
    sigma = SlopeSigma.fit(held_out, 8.0, 0.7)
    for slope in (0.1, 0.3, 0.7):
        assert sigma.of(np.array([slope]), np.array([0.5]), np.array([0.5])) == pytest.approx(
            law(slope), rel=0.12
        )
    assert sigma.rest == pytest.approx(0.01, rel=0.05)
    assert (sigma.correlation_px, sigma.correlated_share) == (8.0, 0.7)
    shares = shares_within(sigma, held_out, np.digitize(held_out.slopes, np.linspace(0, 0.8, 9)[1:-1]))
    assert min(shares) > 0.64
    assert max(shares) < 0.76


def test_place_counts_where_presses_tell():
    held_out = errors_by(lambda s: 0.02 + 0 * s, place=lambda x, y: np.where(x > 0.75, 2.0, 1.0))
    sigma = SlopeSigma.fit(held_out, 8.0, 0.5)
    assert sigma.place[1][3] / sigma.place[1][0] == pytest.approx(2.0, rel=0.25)
    shares = shares_within(sigma, held_out, (held_out.x > 0.85).astype(int) + 2 * (held_out.x < 0.6))
    assert min(shares) > 0.6
    assert max(shares) < 0.76


def test_a_place_that_one_press_touched_counts_little():
    held_out = errors_by(lambda s: 0.02 + 0 * s, place=lambda x, y: np.where(x > 0.75, 4.0, 1.0))
    lone = np.where(held_out.x > 0.75, 0, held_out.press)
    sigma = SlopeSigma.fit(SlopeErrors(**{**vars(held_out), "press": lone}), 8.0, 0.5)
    assert sigma.place[1][3] / sigma.place[1][0] < 3  # of 4


def test_a_few_wild_errors_do_not_widen_it():
    held_out = errors_by(lambda s: 0.02 + 0.1 * s)
    wild = held_out.errors.copy()
    wild[::50] = 3.0
    spoilt = SlopeSigma.fit(SlopeErrors(**{**vars(held_out), "errors": wild}), 8.0, 0.5)
    assert spoilt.clean == pytest.approx(SlopeSigma.fit(held_out, 8.0, 0.5).clean, rel=0.1)


def test_a_frame():
    gradients = np.zeros((4, 5, 2), dtype=np.float32)
    gradients[1, 1], gradients[1, 2] = (0.6, 0.8), (1.2, 1.6)
    image = np.full((4, 5, 3), 100, dtype=np.uint8)
    image[2, 2, 1], image[3, 3, 0] = 255, 0
    untouched = np.zeros((4, 5), dtype=bool)
    untouched[0, 4] = True
    sigma, confidence = LAW.prepare((4, 5))(gradients, image, untouched)
    assert sigma.shape == confidence.shape == (4, 5)
    assert sigma[0, 0] == pytest.approx(0.02)
    assert sigma[0, 4] == pytest.approx(0.01)
    assert sigma[1, 1] == pytest.approx(0.12, rel=1e-2)
    assert sigma[1, 2] == pytest.approx(0.24, rel=1e-2)  # beyond the last knot in proportion
    np.testing.assert_allclose(sigma[[2, 3], [2, 3]], 1.0)
    assert confidence[0, 0] == 1
    assert confidence[1, 1] == pytest.approx((0.03 / 0.12) ** 2, rel=2e-2)
    assert confidence[2, 2] == pytest.approx(0.03**2, rel=1e-4)


def test_frames_and_scattered_pixels_agree():
    law = SlopeSigma.from_dict({**asdict(LAW), "place": [[1.0, 2.0, 0.5, 1.0]] * 2 + [[3.0, 1.0, 1.0, 1.0]]})
    rng = np.random.default_rng(1)
    gradients = rng.uniform(-0.5, 0.5, (30, 40, 2)).astype(np.float32)
    frame, _ = law.prepare((30, 40))(
        gradients, np.full((30, 40, 3), 9, np.uint8), np.zeros((30, 40), dtype=bool)
    )
    y, x = (np.mgrid[:30, :40] + 0.5) / np.array([30, 40])[:, None, None]
    np.testing.assert_allclose(frame, law.of(np.linalg.norm(gradients, axis=-1), x, y), rtol=0.02)


def test_colours_beyond_the_training_presses_are_not_trusted():
    rng = np.random.default_rng(2)
    seen = rng.uniform(-0.3, 0.3, (20_000, 3)).astype(np.float32)
    gamut = Gamut.fit(seen, 2 * seen[:, :2])
    change = np.zeros((2, 3, 3), dtype=np.float32)
    change[0, 1], change[0, 2], change[1, 0] = (0.25, 0, 0), (0.5, 0, 0), (5.0, 0, 0)
    away = gamut.distance_of(change)
    assert away[0, 0] == away[0, 1] == 0
    worth = gamut.slope_per_change
    assert worth == pytest.approx(2 * np.sqrt(2 / 3), rel=0.02)
    assert away[0, 2] == pytest.approx(0.2 * worth, abs=1.6 * gamut.bin_width * worth)
    assert away[1, 0] == pytest.approx(4.7 * worth, rel=0.1)
    args = np.zeros((2, 3, 2), np.float32), np.full((2, 3, 3), 9, np.uint8), np.zeros((2, 3), dtype=bool)
    sigma, confidence = LAW.prepare((2, 3), gamut)(*args, change)
    assert sigma[0, 2] == pytest.approx(np.hypot(0.02, away[0, 2]), rel=1e-5)
    assert confidence[1, 0] < 1e-4 < 0.9 < confidence[0, 1]


def test_the_first_format_is_read():
    old = SlopeSigma.from_dict({"rest": 0.02, "growth": 0.1, "clean": 0.03, "correlation_px": 8.0})
    assert old.of(np.array([0.7]), np.array([0.1]), np.array([0.9])) == pytest.approx(
        np.hypot(0.02, 0.07), rel=0.02
    )
    assert SlopeSigma.from_dict(asdict(LAW)) == LAW
