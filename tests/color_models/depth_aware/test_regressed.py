"""Gel whose colour changes with its depth too: slopes around contacts, which no press has labelled."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.color_models import DepthAwareModel, HierarchicalModel, Samples
from gelform.color_models.depth_aware.regressed import PreparedDepthAware
from made.color_samples import lambertian_change

SHAPE = (72, 96)
PER_DEPTH, TINT = 0.05, np.array([0.06, -0.045, 0.03])  # relative colour, and color change, per px of depth


def bump(center, height_px, width_px):
    """Depth (H, W), px, and slopes (H, W, 2) of a Gaussian bump."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    dx, dy = x - center[0], y - center[1]
    depth = height_px * np.exp(-(dx**2 + dy**2) / (2 * width_px**2))
    return depth, np.stack([-dx, -dy], axis=-1) * (depth / width_px**2)[..., None], np.hypot(dx, dy)


def colours_of(depth, gradients):
    flat = lambertian_change(gradients.reshape(-1, 2), None, None).reshape(*SHAPE, 3)
    return (flat * (1 + PER_DEPTH * depth[..., None]) + TINT * depth[..., None]).astype(np.float32)


def samples_of(presses, read=None):
    """Pixels in the middle of each bump, and untouched ones; with depths where something reads them."""
    parts = []
    for center, height, width in presses:
        depth, gradients, distance = bump(center, height, width)
        change = colours_of(depth, gradients)
        seen = np.zeros(SHAPE) if read is None else read(change)
        for mask, weight in ((distance < width, 1.0), (distance > 5 * width, 0.3)):
            rows, cols = np.nonzero(mask)
            slopes = gradients[mask] if weight == 1 else np.zeros((len(rows), 2))
            parts.append((change[mask], cols, rows, slopes, np.full(len(rows), weight), seen[mask]))
    change, x, y, slopes, weight, seen = (np.concatenate([part[i] for part in parts]) for i in range(6))
    return Samples(change, x, y, slopes, weight, SHAPE, None, None if read is None else seen)


@pytest.fixture(scope="module")
def presses():
    rng = np.random.default_rng(5)
    places = [(x, y) for x in (18, 36, 60, 78) for y in (16, 36, 56)]
    return [(place, rng.uniform(1.0, 4.0), rng.uniform(4.5, 7.5)) for place in places * 2]


@pytest.fixture(scope="module")
def both(presses):
    samples = samples_of(presses)
    read = DepthAwareModel.depth_reader(samples)
    return HierarchicalModel.fit(samples), DepthAwareModel.fit(samples_of(presses, read))


def rms_around(model, center, height, width):
    """RMS slope error in the ring around the labelled part of a bump that was not learnt."""
    depth, gradients, distance = bump(center, height, width)
    read, sigma = model.prepare(np.empty(0), SHAPE).gradients_from_color(colours_of(depth, gradients))
    assert sigma is None
    ring = (distance > 1.2 * width) & (distance < 2.5 * width)
    return np.sqrt(np.mean((read - gradients)[ring] ** 2)), np.sqrt(np.mean(gradients[ring] ** 2))


@pytest.mark.parametrize("height", [1.5, 3.5])
def test_slopes_around_a_contact_are_twice_as_good(both, height):
    plain, aware = (rms_around(model, (47.0, 35.0), height, 6.0)[0] for model in both)
    assert aware < 0.5 * plain


def test_depth_is_read_from_the_frame_in_pixels(both):
    depth, gradients, _ = bump((47.0, 35.0), 3.0, 6.0)
    found = PreparedDepthAware(both[1]).plain_depth(colours_of(depth, gradients))
    assert found.min() == 0
    assert found.max() == pytest.approx(3.0, rel=0.2)


def test_without_depths_it_is_the_plain_model(presses):
    samples = samples_of(presses[:6])
    model = DepthAwareModel.fit(samples)
    change = colours_of(*bump((40.0, 30.0), 2.0, 5.0)[:2])
    ours, theirs = (
        m.prepare(np.empty(0), SHAPE).gradients_from_color(change)[0]
        for m in (model, HierarchicalModel.fit(samples))
    )
    np.testing.assert_allclose(ours, theirs, atol=1e-7)


def test_a_share_lies_between_the_plain_model_and_the_whole(presses, both):
    whole = both[1]
    change = colours_of(*bump((40.0, 30.0), 2.0, 5.0)[:2])
    none, half, one = (
        whole.with_share(s).prepare(np.empty(0), SHAPE).gradients_from_color(change)[0] for s in (0, 0.5, 1)
    )
    plain = whole.plain.prepare(np.empty(0), SHAPE).gradients_from_color(change)[0]
    np.testing.assert_allclose(none, plain, atol=1e-6)
    moved, middle = np.abs(one - none).max(), np.abs(half - (none + one) / 2).max()
    assert moved > 0.02
    assert middle < 0.05 * moved
    read = DepthAwareModel.depth_reader(samples_of(presses))
    fitted = DepthAwareModel.fit(samples_of(presses, read), share=0.5)
    np.testing.assert_allclose(fitted.place, 0.5 * whole.place)
    np.testing.assert_allclose(fitted.beside.nodes, whole.with_share(0.5).beside.nodes)


def test_an_exposure_step_is_no_depth(both):
    prepared = both[1].prepare(np.empty(0), SHAPE)
    depth, gradients, _ = bump((47.0, 35.0), 3.0, 6.0)
    change = colours_of(depth, gradients)
    before, after = (prepared.plain_depth(change + step) for step in (np.float32(0), np.float32(0.01)))
    assert np.abs(after - before).max() < 0.3


def test_it_is_saved_and_named(both):
    model = both[1]
    again = DepthAwareModel.from_arrays(*model.to_arrays())
    change = colours_of(*bump((30.0, 30.0), 2.0, 5.0)[:2])
    frames = [m.prepare(np.empty(0), SHAPE).gradients_from_color(change)[0] for m in (model, again)]
    np.testing.assert_array_equal(*frames)
    assert not any(variant.in_auto for variant in DepthAwareModel.variants(30))
    with pytest.raises(ValueError, match="Expected images of 72x96 px"):
        model.prepare(np.empty(0), (96, 72))


def test_a_set_of_settings_is_refused_as_by_the_plain_model():
    samples = replace(samples_of([((47, 35), 2.0, 6.0)]), depth_px=None)
    with pytest.raises(ValueError, match="ridge > 0"):
        DepthAwareModel.fit(samples, ridge=0)
