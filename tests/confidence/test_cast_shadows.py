"""Cast shadows: darkness that no slope explains, and the slope that the other lights show there."""

import numpy as np
import pytest

from gelform.confidence import cast_shadows
from gelform.confidence.cast_shadows import DOUBTED, GIVEN_BACK, LEAST_SHARE, CastShadows
from gelform.confidence.forward_cells import CELL, explained_change
from kernel_agreement import assert_kernel_agrees

SHAPE = (96, 128)
NOISE, CLEAN = 0.03, 0.02
TOWARD = np.deg2rad([-30.0, 210.0, 90.0])  # of the three lights
PATCH = np.s_[40:64, 48:80]


def cells_of_three_lights():
    """Each channel changes by 1.5 of the slope towards its light, and by a little of that slope's square."""
    cells = np.zeros((-(-SHAPE[0] // CELL[0]), -(-SHAPE[1] // CELL[1]), 9, 3), np.float32)
    cells[..., 0, :], cells[..., 1, :] = 1.5 * np.cos(TOWARD), 1.5 * np.sin(TOWARD)
    cells[..., 2, :] = cells[..., 4, :] = -0.2
    return cells


@pytest.fixture(scope="module")
def shadows():
    return CastShadows(cells_of_three_lights(), SHAPE, NOISE, CLEAN)


def read_of(change):
    """Slopes (H, W, 2) of a color change by the same lights, to first order: what a color model reads."""
    along = 1.5 * np.stack([np.cos(TOWARD), np.sin(TOWARD)], axis=-1)
    return (change @ np.linalg.pinv(along).T).astype(np.float32)


def sloping_away(light, slope):
    away = -slope * np.array([np.cos(TOWARD[light]), np.sin(TOWARD[light])])
    return np.broadcast_to(away, (*SHAPE, 2)).astype(np.float32)


def test_no_slope_is_dark(shadows):
    rng = np.random.default_rng(0)
    slopes = np.repeat(np.repeat(rng.uniform(-0.5, 0.5, (24, 32, 2)), 4, 0), 4, 1).astype(np.float32)
    change = explained_change(cells_of_three_lights(), slopes)
    np.testing.assert_allclose(shadows.darkness(change, slopes), 0, atol=1e-5)
    assert taken_back(shadows, change, slopes) is None


def taken_back(shadows, change, read, bias=(0, 0), unseen=None):
    """What slopes change by, and the deviation that they get; None where there is no shadow."""
    slopes, sigma, confidence = read.copy(), np.zeros(SHAPE, np.float32), np.ones(SHAPE, np.float32)
    frame = change, slopes, np.array(bias, np.float32), unseen
    return (slopes - read, sigma) if shadows.take_back(*frame, sigma, confidence, 0.0) else None


def size_of(slopes):
    return np.linalg.norm(slopes, axis=-1)


def hill():
    """Slopes (H, W, 2) of a hill 8 px high in the middle, 0.55 at the steepest."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    u, v = x - SHAPE[1] / 2, y - SHAPE[0] / 2
    height = 8 * np.exp(-(u**2 + v**2) / (2 * 9**2))
    return (-height / 9**2)[..., None] * np.stack([u, v], axis=-1)


def lee(light, of):
    """Pixels 18 to 30 px from the middle, within 30 degrees of away from a light; or towards it."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    u, v = x - SHAPE[1] / 2, y - SHAPE[0] / 2
    along = of * (u * np.cos(TOWARD[light]) + v * np.sin(TOWARD[light]))
    away = np.hypot(u, v)
    return (away > 18) & (away < 30) & (along > 0.87 * away)


def read_in_shadow(light, patch, lost=0.4):
    """True slopes of the hill, the color change with less of a light in a patch, and the slopes read from it."""
    true = hill().astype(np.float32)
    change = explained_change(cells_of_three_lights(), true)
    change[..., light] -= np.float32(lost) * patch
    return true, change, read_of(change)


@pytest.mark.parametrize("light", range(3))
def test_a_hidden_light_is_given_back_behind_the_hill(shadows, light):
    # The channel brightens with the slope in the direction TOWARD: that of a surface that rises away from the light.
    patch = lee(light, 1)
    true, change, read = read_in_shadow(light, patch)
    shift, sigma = taken_back(shadows, change, read)
    np.testing.assert_allclose(shadows.sigma(change, read), sigma, rtol=1e-5)
    before, after = (size_of(one - true)[patch].mean() for one in (read, read + shift))
    assert after < (1 - 0.5 * GIVEN_BACK) * before, "the patch's rim is shared with blocks around it"
    assert np.median(sigma[patch]) >= DOUBTED * CLEAN
    assert sigma[hill_top()].max() == 0, "a hill casts no shadow on its own top"


def hill_top():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.hypot(x - SHAPE[1] / 2, y - SHAPE[0] / 2) < 6


@pytest.mark.parametrize("light", range(3))
def test_what_faces_the_light_is_in_no_shadow(shadows, light):
    _, change, read = read_in_shadow(light, lee(light, -1), lost=0.1)
    found = taken_back(shadows, change, read)
    assert found is None or found[1][lee(light, -1)].mean() < 0.2 * DOUBTED * CLEAN


def test_the_gel_does_not_turn_to_the_hidden_light(shadows):
    change = explained_change(cells_of_three_lights(), sloping_away(0, 0.0))
    change[PATCH] -= 0.6  # of all lights: no slope at all is read, and none is made
    assert taken_back(shadows, change, read_of(change)) is None


def test_faint_darkness_counts_around_sure_darkness_alone(shadows):
    dark = np.zeros(shadows.coarse, np.float32)
    dark[2:6, 2:6] = NOISE
    dark[10:16, 10:16], dark[12, 12] = NOISE, 2 * NOISE
    found = shadows.regions(dark)
    assert found[10:16, 10:16].all()
    assert found.sum() == 36


def test_a_bias_and_unseen_pixels(shadows):
    bias = np.array([0.02, -0.01], np.float32)
    _, change, read = read_in_shadow(1, lee(1, 1))
    for one, other in zip(taken_back(shadows, change, read - bias, bias), taken_back(shadows, change, read)):
        np.testing.assert_allclose(one, other, atol=1e-5)
    assert taken_back(shadows, change, read, unseen=np.ones(SHAPE, bool)) is None


@pytest.mark.parametrize("shape", [(12, 16), (10, 13), (3, 2), (41, 7)])
def test_darkness_of_blocks(shape):
    """Also of sizes that are no multiples of a block's: what is there is averaged."""
    rng = np.random.default_rng(3)
    rows, columns = (-(-n // 4) for n in shape)
    change, slopes = (rng.normal(0, 0.3, (*shape, n)).astype(np.float32) for n in (3, 2))
    table = rng.normal(0, 1, (rows, 12, columns)).astype(np.float32)
    unseen, bias = rng.uniform(size=shape) < 0.01, np.array([0.02, -0.01], np.float32)

    def in_numpy(change, slopes, unseen, table, bias, *_):
        blocks = [
            [(np.s_[4 * i : 4 * i + 4], np.s_[4 * j : 4 * j + 4]) for j in range(columns)]
            for i in range(rows)
        ]
        means = [
            np.array([[one[b].mean(axis=(0, 1)) for b in row] for row in blocks]) for one in (change, slopes)
        ]
        p, q = np.moveaxis(means[1] + bias, -1, 0)
        terms = np.stack([p, q, p * p, p * q, q * q, p**3, p * p * q, p * q * q, q**3], axis=1)
        dark = (terms * table[:, :9]).sum(axis=1) - (np.moveaxis(means[0], -1, 1) * table[:, 9:]).sum(axis=1)
        dark[np.array([[unseen[b].any() for b in row] for row in blocks])] = 0
        return np.stack([p, q], axis=-1), dark

    out = np.empty((rows, columns, 2), np.float32), np.empty((rows, columns), np.float32)
    work = np.empty(5 * (shape[1] + 4 + columns), np.float32)
    frame = change, slopes, unseen, table, bias
    assert_kernel_agrees(cast_shadows._shadow_darkness, in_numpy, *frame, *out, work)


def test_light_that_is_given_back():
    rng = np.random.default_rng(4)
    size = (5, 6)
    behind, dark = rng.uniform(size=size) < 0.5, rng.uniform(0.01, 0.2, size).astype(np.float32)
    slopes, toward, slope_of, null = (
        rng.normal(0, 0.3, (*size, *more)).astype(np.float32) for more in ((2,), (3, 2), (3, 2), (3,))
    )

    def in_numpy(behind, dark, slopes, toward, slope_of, null, out, noise_square, share, least_share, doubt):
        found = np.zeros((*size, 3))
        for at in np.argwhere(behind):
            at = tuple(at)
            facing = toward[at] @ slopes[at]
            k = np.argmin(facing)
            lost = dark[at] ** 3 / (dark[at] ** 2 + noise_square) / max(null[at][k], least_share)
            change = share * slope_of[at][k] * lost
            turned = max(-facing[k], 0) / max(change @ toward[at][k], 1e-12)
            steep = np.linalg.norm(slopes[at]) / max(np.linalg.norm(change), 1e-12)
            found[at] = *(min(turned, steep, 1) * change), doubt
        return found

    numbers = 0.02**2, GIVEN_BACK, LEAST_SHARE, 0.1
    maps = behind, dark, slopes, toward, slope_of, null, np.empty((*size, 3), np.float32)
    assert_kernel_agrees(cast_shadows._give_back_light, in_numpy, *maps, *numbers)


@pytest.mark.parametrize("shape", [(24, 40), (22, 37), (3, 2), (4, 9)])
def test_what_blocks_say_is_spread_over_pixels(shape):
    rng = np.random.default_rng(5)
    rows, columns = (-(-n // 4) for n in shape)
    found = rng.normal(0, 0.2, (rows, columns, 3)).astype(np.float32)
    found[rng.uniform(size=(rows, columns)) < 0.7] = 0
    maps = [rng.uniform(0.05, 0.3, (*shape, *more)).astype(np.float32) for more in ((2,), (), ())]

    def in_numpy(found, gradients, sigma, confidence, work, clean, least):
        y, x = (np.clip((np.arange(n) + 0.5) / 4 - 0.5, 0, -(-n // 4) - 1) for n in shape)
        i, j = (np.minimum(at.astype(int), max(n - 2, 0)) for at, n in ((y, rows), (x, columns)))
        v, u = (y - i)[:, None, None], (x - j)[:, None]
        below, beside = np.minimum(i + 1, rows - 1), np.minimum(j + 1, columns - 1)
        lines = found[i] * (1 - v) + found[below] * v
        whole = lines[:, j] * (1 - u) + lines[:, beside] * u
        total = sigma**2 + (whole**2).sum(axis=-1)
        doubted = np.where(whole.any(axis=-1), np.maximum(clean**2 / total, least), np.inf)
        return gradients + whole[..., :2], np.sqrt(total), np.minimum(confidence, doubted)

    work = np.empty(3 * columns, np.float32)
    assert_kernel_agrees(cast_shadows._doubt_shadows, in_numpy, found, *maps, work, 0.05, 0.002)
