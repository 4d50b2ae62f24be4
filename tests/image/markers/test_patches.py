"""A dot's patch is found where it was moved to, to hundredths of a pixel, whatever the light and the dot's shape."""

import numpy as np
import pytest

from gelform.image.markers import MarkerFollower, patches
from gelform.image.markers.patches import MarkerPatches, StretchedPatches, level_from_image, logs_from_image
from kernel_agreement import assert_kernel_agrees
from made.dots import RADIUS, grid, image_of_dots

pytestmark = pytest.mark.linear_algebra

REST = grid()


def prepared(rest=REST, **how):
    return MarkerPatches(logs_from_image(image_of_dots(rest, **how)), rest, RADIUS)


def sampled(image, x, y, side):
    """Catmull-Rom interpolation on a square, from its definition; the nearest value beyond the border."""

    def weights(t):
        return np.array(
            [-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, t**3 - t**2]
        ) / 2  # fmt: skip

    rows, columns = (np.floor(v).astype(int) + np.arange(-1, side + 2) for v in (y, x))
    taken = image[np.clip(rows, 0, len(image) - 1)][:, np.clip(columns, 0, image.shape[1] - 1)].astype(float)
    down, across = (weights(v - np.floor(v)) for v in (y, x))
    return sum(
        down[i] * across[j] * taken[i : i + side, j : j + side] for i in range(4) for j in range(4)
    ).ravel()


def reference(image, corners, weight, basis, triangle, shift, fit, side, steps, longest):
    """The steps of the docstring's paper in double precision, one solve each."""
    shift, fit = shift.astype(float), fit.astype(float)
    for i, corner in enumerate(corners):
        for _ in range(steps):
            seen = weight[i] * sampled(image, *(corner + shift[i]), side)
            on = basis[i].astype(float) @ seen
            strength, dx, dy = np.linalg.solve(triangle[i].astype(float), on[6:])
            step = np.array([dx, dy]) / max(strength, 0.3)
            length = np.linalg.norm(step)
            shift[i] -= step * min(1, longest / length)
            fit[i] = strength, max(seen @ seen - on @ on, 0), on[6] ** 2, length
            if length < 0.004:
                break
    return shift, fit


def test_the_kernel_is_the_written_method():
    own = prepared(noise=1.0)
    image = logs_from_image(image_of_dots(np.add(REST, [1.3, -0.6]), noise=1.0, seed=1))
    count = len(REST)
    assert_kernel_agrees(
        patches._follow_patches, reference, image, own.corners_px, own.weights, own._basis, own._triangle,
        np.zeros((count, 2), np.float32), np.zeros((count, 4), np.float32), own.side_px, 3, 1.0,
        tolerance=1e-3,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("shift", "light"),
    [((0.0, 0.0), 0), ((0.37, -0.81), 0), ((2.4, 1.6), 0), ((-3.1, 2.2), 0), ((0.0, 0.0), 0.6)],
)
def test_shifts_to_hundredths_of_a_pixel(shift, light):
    """The light of a contact moves no dot."""
    found = prepared()(logs_from_image(image_of_dots(REST + shift, light=light)), np.zeros_like(REST))
    assert found.ok.all()
    assert np.abs(found.shift_px - shift).max() < (0.05 if light else 0.03)


def test_dots_of_all_sizes_and_pieces():
    """Two overlapping spots make a broken, lopsided dot; it moves as a round one does."""
    rest = np.concatenate([REST, np.add(REST[::3], [2.5, 1.0])])
    radii = np.where(np.arange(len(rest)) < len(REST), RADIUS, 1.5)
    own = MarkerPatches(logs_from_image(image_of_dots(rest, radii=radii)), REST, RADIUS)
    found = own(logs_from_image(image_of_dots(np.add(rest, [1.2, -0.4]), radii=radii)), np.zeros_like(REST))
    assert found.ok.all()
    assert np.abs(found.shift_px - [1.2, -0.4]).max() < 0.03


def test_dots_that_are_gone_are_not_ok():
    image = logs_from_image(image_of_dots(np.delete(REST, [5, 20], axis=0), noise=1.0, seed=2))
    found = prepared(noise=1.0)(image, np.zeros_like(REST))
    np.testing.assert_array_equal(found.ok, ~np.isin(np.arange(len(REST)), [5, 20]))
    of = np.array([3, 5, 8])
    some = prepared(noise=1.0)(image, np.zeros((3, 2)), of)
    np.testing.assert_array_equal(some.ok, [True, False, True])
    np.testing.assert_array_equal(some.shift_px, found.shift_px[of])


def test_a_dot_that_left_by_the_border_is_not_ok():
    rest = grid(margin=6.0)
    image = logs_from_image(image_of_dots(np.add(rest, [-5.0, 0.0])))
    found = prepared(rest)(image, np.full_like(rest, [-5.0, 0.0]))
    np.testing.assert_array_equal(found.ok, rest[:, 0] > 6)


def test_a_dot_larger_than_the_largest_patch():
    rest = np.array([[64.0, 48.0]])
    own = MarkerPatches(logs_from_image(image_of_dots(rest, radii=25.0)), rest, 25.0)
    found = own(logs_from_image(image_of_dots(np.add(rest, [1.2, -0.4]), radii=25.0)), np.zeros((1, 2)))
    assert found.ok.all()
    assert np.abs(found.shift_px - [1.2, -0.4]).max() < 0.05


def test_sigma_is_that_of_noise():
    own = prepared()
    runs = [
        own(logs_from_image(image_of_dots(REST, noise=2.0, seed=s)), np.zeros_like(REST)) for s in range(12)
    ]
    spread = np.sqrt(np.mean([run.shift_px**2 for run in runs]))
    assert np.mean([run.sigma_px for run in runs]) == pytest.approx(spread, rel=0.25)


def test_logs_of_bytes_and_floats_agree():
    image = image_of_dots(REST)
    by_floats = logs_from_image(image.astype(np.float32))
    assert np.abs(logs_from_image(image) - by_floats).max() < 0.02
    for kind in (np.uint8, float):
        assert (level_from_image(np.full((4, 5, 3), [10, 20, 60], dtype=kind)) == 30).all()


FEW_RADIUS = 5.5
FEW = grid(32.0, (160, 192), 16.0)
UNTOUCHED = image_of_dots(FEW, radii=FEW_RADIUS, shape=(160, 192), noise=1.0)
LOGS = logs_from_image(UNTOUCHED)
DOT, MOVED = 8, np.array([3.3, -1.6])


def image_of_stretched(warp, moved=MOVED, light=0.3):
    """All dots at rest but one, which a map (2, 2) about its center has stretched."""
    y, x = np.mgrid[:160, :192].astype(float)
    clean = image_of_dots(np.delete(FEW, DOT, 0), radii=FEW_RADIUS, shape=(160, 192), light=light).astype(
        float
    )
    away = np.stack([x, y], axis=-1) - (FEW[DOT] + moved)
    inside = np.hypot(*np.moveaxis(away @ np.linalg.inv(warp).T, -1, 0))
    clean *= (1 - 0.85 / (1 + np.exp((inside - FEW_RADIUS) / 0.4)))[..., None]
    noisy = clean + np.random.default_rng(1).normal(0, 1, clean.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def turned(longer, shorter, degrees):
    """A stretch along a direction."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, -s], [s, c]])
    return turn @ np.diag([longer, shorter]) @ turn.T


@pytest.mark.parametrize(
    ("longer", "shorter", "degrees"), [(1.0, 1.0, 0), (1.6, 1.1, 0), (1.7, 0.9, 40), (0.9, 0.6, 110)]
)
def test_a_stretched_dot_is_found_where_it_is(longer, shorter, degrees):
    patches = MarkerPatches(LOGS, FEW, FEW_RADIUS)
    logs = logs_from_image(image_of_stretched(turned(longer, shorter, degrees)))
    found = StretchedPatches(LOGS, patches)(logs, MOVED[None] + [[1.5, -1.0]], np.array([DOT]))
    assert found.ok[0]
    assert np.abs(found.shift_px[0] - MOVED).max() < 0.1
    assert found.sigma_px[0] < 0.1


def test_a_shift_alone_refuses_it_and_the_follower_does_not():
    image = image_of_stretched(turned(1.9, 1.3, 20))
    plain = MarkerPatches(LOGS, FEW, FEW_RADIUS)(logs_from_image(image), np.zeros((len(FEW), 2)))
    assert not plain.ok[DOT]
    follower = MarkerFollower(UNTOUCHED)
    flow = follower(image)
    at = np.linalg.norm(follower.rest_px - FEW[DOT], axis=1).argmin()
    assert flow.seen.all()
    assert np.abs(flow.displacement_px[at] - MOVED).max() < 0.25


def test_no_dot_is_none():
    patches = MarkerPatches(LOGS, FEW, FEW_RADIUS)
    empty = logs_from_image(
        image_of_dots(np.delete(FEW, DOT, 0), radii=FEW_RADIUS, shape=(160, 192), noise=1.0)
    )
    assert not StretchedPatches(LOGS, patches)(empty, np.zeros((1, 2)), np.array([DOT])).ok[0]
    none = StretchedPatches(LOGS, patches)(empty, np.zeros((0, 2)), np.zeros(0, np.intp))
    assert len(none.shift_px) == len(none.ok) == 0
