"""Standard deviation and confidence of a frame: the law, clipped pixels, colours never seen, a model's own."""

from dataclasses import asdict

import numpy as np
import pytest

from gelform.color_models._shared.gamut import Gamut
from gelform.confidence.frame_sigma import PreparedSigma, UnknownSigma, with_model_sigma
from gelform.confidence.slope_sigma import SlopeSigma

LAW = SlopeSigma(rest=0.01, slopes=(0.0, 0.5, 1.0), sigmas=(0.02, 0.05, 0.12), clean=0.03, correlation_px=8.0)


def test_a_frame():
    gradients = np.zeros((4, 5, 2), dtype=np.float32)
    gradients[1, 1], gradients[1, 2] = (0.6, 0.8), (1.2, 1.6)
    image = np.full((4, 5, 3), 100, dtype=np.uint8)
    image[2, 2, 1], image[3, 3, 0] = 255, 0
    untouched = np.zeros((4, 5), dtype=bool)
    untouched[0, 4] = True
    sigma, confidence = PreparedSigma(LAW, (4, 5), None)(gradients, image, untouched)
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
    frame, _ = PreparedSigma(law, (30, 40), None)(
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
    sigma, confidence = PreparedSigma(LAW, (2, 3), gamut)(*args, change)
    assert sigma[0, 2] == pytest.approx(np.hypot(0.02, away[0, 2]), rel=1e-5)
    assert confidence[1, 0] < 1e-4 < 0.9 < confidence[0, 1]


def test_without_a_law_only_clipped_pixels_lose_confidence():
    image = np.full((2, 3, 3), 9, np.uint8)
    image[0, 1, 2], image[1, 0, 0] = 255, 0
    sigma, confidence = UnknownSigma()(np.zeros((2, 3, 2), np.float32), image, np.zeros((2, 3), dtype=bool))
    assert sigma is None
    np.testing.assert_array_equal(confidence, [[1, 0, 1], [0, 1, 1]])


def test_of_two_deviations_the_larger_counts():
    sigma, confidence = np.full((2, 2), 0.05, np.float32), np.full((2, 2), 0.8, np.float32)
    own = np.full((2, 2, 2), 0.01, np.float32)
    own[0, 0] = 0.02, 0.3
    both, found = with_model_sigma(sigma, confidence, own, clean=0.03)
    np.testing.assert_allclose(both[0, 0], [0.05, 0.3])
    np.testing.assert_allclose(both[1, 1], 0.05)
    np.testing.assert_allclose(found, [[0.01, 0.8], [0.8, 0.8]], rtol=1e-6)
    alone, _ = with_model_sigma(None, confidence, own, clean=0.03)
    assert alone is own
    alike, same = with_model_sigma(sigma, confidence, None, clean=0.03)
    assert alike.shape == (2, 2, 2)
    assert same is confidence
    assert with_model_sigma(None, confidence, None, clean=0.03)[0] is None
