"""The frame's one pass gives what the causes give one by one, and the one rule of confidence."""

import numpy as np
import pytest

from gelform.background.untouched import Reference
from gelform.color_models._shared.forward import ForwardResponse
from gelform.confidence import raised
from gelform.confidence.cast_shadows import CastShadows
from gelform.confidence.causes import CAUSES
from gelform.confidence.causes.seen import LEAST_CONFIDENCE
from gelform.confidence.forward_cells import coefficients_of_cells, explained_change
from gelform.confidence.raised import PreparedCauses
from kernel_agreement import assert_kernel_agrees
from made.seen_frames import CLEAN, SHAPE, limits, patch

BIAS = np.array([0.02, -0.01], np.float32)
REFERENCE = Reference(np.zeros(3, np.float32), 0.0, BIAS, None, ())


def cells_of():
    rng = np.random.default_rng(4)
    forward = ForwardResponse(rng.normal(0, 0.4, (50, 3)), (3, 2, 1), SHAPE, np.full(3, 0.02))
    return coefficients_of_cells(forward)


@pytest.mark.parametrize("with_forward", [True, False])
@pytest.mark.parametrize("outside", [None, patch(np.s_[:8, :10])], ids=["lit", "dark corner"])
def test_one_pass_and_one_by_one(with_forward, outside):
    rng = np.random.default_rng(1)
    rest = rng.integers(90, 96, (*SHAPE, 3), dtype=np.uint8)
    image = np.clip(rest + rng.normal(0, 6, rest.shape), 20, 230).astype(np.uint8)
    image[30, 50], image[25:28, 5] = 255, 0
    cells = cells_of() if with_forward else None
    causes = PreparedCauses(limits(outside=outside), cells, rest)
    raw = rng.uniform(-0.5, 0.5, (*SHAPE, 2)).astype(np.float32)
    change = explained_change(cells_of(), raw) + rng.normal(0, 0.1, (*SHAPE, 3)).astype(np.float32)
    markers = patch(np.s_[12:16, 40:44])
    law = rng.uniform(0.01, 0.08, SHAPE).astype(np.float32)
    sigma = law.copy()
    confidence = causes(image, change, raw - BIAS, REFERENCE, markers, sigma)
    seen = causes.seen(image, change, raw, markers=markers, lost=None, lost_image=image)
    maps = {name: cause(seen) for name, cause in CAUSES.items()}
    wanted = np.sqrt(law**2 + sum(one.astype(float) ** 2 for one in maps.values()))
    most = causes.limits.unseen  # where several causes leave nothing, they need not be counted twice
    np.testing.assert_allclose(np.minimum(sigma, most), np.minimum(wanted, most), rtol=2e-3)
    floor = np.where(sigma < most, LEAST_CONFIDENCE, 0)
    np.testing.assert_allclose(confidence, np.clip((CLEAN / sigma) ** 2, floor, 1), rtol=1e-5)
    there = {name for name, one in maps.items() if one.any()}
    assert there == {"saturated", "dark", "marker", "compression"} | (
        {"shadow", "specular", "inconsistent"} if with_forward else set()
    ) | ({"outside"} if outside is not None else set())


def test_cast_shadows_move_slopes_and_raise_sigma():
    rest = np.full((*SHAPE, 3), 100, np.uint8)
    cells = cells_of()
    shadows = CastShadows(cells, SHAPE, 0.03, CLEAN)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] - np.array(SHAPE)[:, None, None] / 2
    hill = 6 * np.exp(
        -(x**2 + y**2) / 72
    )  # px high, and dark all around: somewhere behind it from each light
    raw = (-hill[..., None] / 36 * np.stack([x, y], axis=-1)).astype(np.float32)
    change = explained_change(cells, raw)
    change[(np.hypot(x, y) > 9) & (np.hypot(x, y) < 16)] -= 0.1
    causes, without = (
        PreparedCauses(limits(noise=1.0), cells, rest, shadows),
        PreparedCauses(limits(noise=1.0), cells, rest),
    )
    slopes, plain = raw - BIAS, raw - BIAS
    sigma, law = np.full(SHAPE, 0.05, np.float32), np.full(SHAPE, 0.05, np.float32)
    confidence = causes(rest, change, slopes, REFERENCE, None, sigma)
    without(rest, change, plain, REFERENCE, None, law)
    moved = np.linalg.norm(slopes - plain, axis=-1)
    assert moved.max() > 0.01
    assert moved[:5].max() == 0
    cast = shadows.sigma(change, raw)
    assert (cast >= 0.999 * moved - 1e-6).all()
    np.testing.assert_allclose(sigma, np.hypot(law, cast), rtol=1e-4)
    np.testing.assert_allclose(confidence, np.minimum(1, (CLEAN / sigma) ** 2), rtol=1e-5)
    seen = causes.seen(rest, change, raw, markers=None, lost=None, lost_image=rest)
    np.testing.assert_allclose(CAUSES["shadow"](seen), cast, atol=1e-6)


def numpy_raise_sigma(
    image, change, gradients, unseen, cells, bias, gain, sigma, confidence, marked, unexplained, sure, per_change,
    unseen_sigma, clean, added, per_bend, bend_from, per_slope, least, reach,
    dark_to, saturated_from,
):  # fmt: skip
    """What the kernel should give."""
    ends = (image <= dark_to).any(axis=-1) | (image >= saturated_from).any(axis=-1)
    total = sigma.astype(float) ** 2 + (added * gain) ** 2
    if cells is not None:
        apart = change - explained_change(cells, gradients + bias)
        size = np.sqrt((apart**2).mean(axis=-1))
        total += (per_change * np.maximum(size - unexplained, 0)) ** 2
        ends |= size**2 > sure**2 + per_slope**2 * ((gradients + bias) ** 2).sum(axis=-1)
    square = np.zeros(image.shape[:2])
    for a in range(image.shape[0]):
        for b in range(image.shape[1]):
            for y, x in ((a - reach, b), (a + reach, b), (a, b - reach), (a, b + reach)):
                if 0 <= y < image.shape[0] and 0 <= x < image.shape[1]:
                    square[a, b] += ((gradients[y, x].astype(float) - gradients[a, b]) ** 2).sum() / 2
    total += (per_bend * np.maximum(np.sqrt(square) - bend_from, 0)) ** 2
    if unseen is not None:
        total += unseen * unseen_sigma**2
    floor = np.where(total < unseen_sigma**2, least, 0)
    return np.sqrt(total), np.clip(clean**2 / total, floor, 1), ends


@pytest.mark.parametrize("optional", [True, False])
@pytest.mark.parametrize("shape", [SHAPE, (9, 33), (1, 5), (3, 1), (2, 64), (4, 65)])
def test_the_kernel_agrees_with_numpy(optional, shape):
    rng = np.random.default_rng(0)
    cells = cells_of()[: -(-shape[0] // 8), : -(-shape[1] // 16)].copy()
    assert_kernel_agrees(
        raised._raise_sigma, numpy_raise_sigma, rng.integers(0, 256, (*shape, 3), dtype=np.uint8),
        rng.normal(0, 0.2, (*shape, 3)).astype(np.float32), rng.normal(0, 0.3, (*shape, 2)).astype(np.float32),
        rng.uniform(size=shape) > 0.8 if optional else None, cells if optional else None, BIAS,
        rng.uniform(0.005, 0.02, shape).astype(np.float32), rng.uniform(0.01, 0.1, shape).astype(np.float32),
        np.empty(shape, np.float32), np.empty(shape, bool), 0.1, 0.4, 4.5, 40.0, 0.04, 3.0, 1.5 if optional else 0.0, 0.2,
        0.3, 0.002, 2, 2, 254,
    )  # fmt: skip
