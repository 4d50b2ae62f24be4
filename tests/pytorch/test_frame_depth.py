"""The frame's depth is that of the numpy path, on sizes that blocks of four pixels do not divide too."""

import cv2
import numpy as np
import pytest

from gelform.color_models import frame_depth

torch = pytest.importorskip("torch", reason="needs the extra 'torch'")
from gelform.torch.frame_depth import FrameDepth  # noqa: E402


def bump(shape, center):
    """Color change (H, W, 3) and slopes (H, W, 2) of a bump 4 px high on gel that tilts a little, with noise."""
    rng = np.random.default_rng(shape)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    dx, dy = x - center[0], y - center[1]
    slopes = np.stack([-dx, -dy], axis=-1) * (4 / 64 * np.exp(-(dx**2 + dy**2) / 128))[..., None]
    noise = rng.normal(0, 0.004, (*shape, 3))
    change = slopes @ rng.uniform(-1, 1, (2, 3)) + 0.02 + noise
    return change.astype(np.float32), (slopes + 0.01 + noise[..., :2]).astype(np.float32)


def planes(*maps):
    return torch.from_numpy(np.stack(maps)).permute(0, 3, 1, 2)


@pytest.mark.parametrize(
    ("shape", "untouched"),
    [((64, 96), 0.01), ((61, 90), 0.01), ((7, 33), 0.01), ((61, 90), 1e-6)],
    ids=["divided", "not_divided", "low", "the_least_changed"],
)
def test_depth_is_the_numpy_paths(shape, untouched):
    frames = [bump(shape, (20, 5)), bump(shape, (12.5, shape[0] / 2))]
    ours, theirs = FrameDepth(shape, untouched), frame_depth.FrameDepth(shape, untouched)
    changes, slopes = (planes(*maps) for maps in zip(*frames))
    found = ours(slopes, ours.rest(changes))
    for frame, depth, full in zip(frames, found[:, 0], ours.in_full(found)[:, 0]):
        expected = theirs(*frame)
        assert expected.max() > 0.3
        np.testing.assert_allclose(depth, expected, atol=2e-5 * expected.max())
        everywhere = cv2.resize(expected, shape[::-1], interpolation=cv2.INTER_LINEAR)
        np.testing.assert_allclose(full, everywhere, atol=2e-5 * expected.max())


def test_values_of_the_coarser_grid_are_opencvs():
    values = np.random.default_rng(0).normal(size=(30, 45, 2)).astype(np.float32)
    ours, (rows, columns) = FrameDepth((30, 45), 0.1), frame_depth.coarse_grid((30, 45))[0]
    coarse, full = ours.made_coarse(planes(values)), ours.in_full(ours.made_coarse(planes(values)))
    means = cv2.resize(values, (columns, rows), interpolation=cv2.INTER_AREA)
    np.testing.assert_allclose(coarse[0].permute(1, 2, 0), means, atol=1e-6)
    between = cv2.resize(means, (45, 30), interpolation=cv2.INTER_LINEAR)
    np.testing.assert_allclose(full[0].permute(1, 2, 0), between, atol=1e-6)
