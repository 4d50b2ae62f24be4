"""Colours carried to depth 0: against the law of near lights written out, light by light, at every depth."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.color_models import DepthByLightsModel, HierarchicalModel, NearLightModel, Samples
from gelform.color_models.depth_aware.by_lights import light_per_depth

SHAPE = (72, 96)
MIDDLE = np.array([(SHAPE[1] - 1) / 2, (SHAPE[0] - 1) / 2])
LEDS_PX = np.array([[70.0, 8, 40], [-50, 60, 45], [-40, -65, 38]])
MIXTURE = np.array([[1.0, 0.15, 0.05], [0.1, 1.0, 0.2], [0.0, 0.12, 1.0]])
BACKGROUND = np.full((*SHAPE, 3), 70.0, np.float32)
SEEN = 70 / 80


def light(x, y, depth, gradients, response=1.0):
    """Light (N, 3) of surface points by the inverse square and cosine laws."""
    total = np.zeros((len(x), 3))
    normals = np.concatenate([-gradients, np.ones((len(x), 1))], axis=1)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    for k, led in enumerate(LEDS_PX):
        way = led - np.stack([x - MIDDLE[0], y - MIDDLE[1], depth], axis=1)
        cosine = np.maximum(np.sum(way * normals, axis=1), 0) / np.linalg.norm(way, axis=1) ** 3
        total += np.linalg.norm(led) ** 2 * cosine[:, None] * MIXTURE[:, k]
    return total**response


def change_at(x, y, depth, gradients, response=1.0):
    """Color change (N, 3) against the untouched gel, with the offset of `hierarchical`."""
    x, y, depth = (np.asarray(a, dtype=float) for a in (x, y, depth))
    rest = light(x, y, 0 * x, np.zeros((len(x), 2)), response)
    return SEEN * (light(x, y, depth, gradients, response) / rest - 1)


def bump(center, height_px, width_px):
    """Depth (H, W), px, slopes (H, W, 2), color change (H, W, 3) and distance of a Gaussian bump."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    dx, dy = x - center[0], y - center[1]
    depth = height_px * np.exp(-(dx**2 + dy**2) / (2 * width_px**2))
    slopes = np.stack([-dx, -dy], axis=-1) * (depth / width_px**2)[..., None]
    change = change_at(x.ravel(), y.ravel(), depth.ravel(), slopes.reshape(-1, 2))
    return depth, slopes, change.reshape(*SHAPE, 3).astype(np.float32), np.hypot(dx, dy)


def samples_of(presses, read=None):
    """Pixels in the middle of each bump, and untouched ones; with depths where something reads them."""
    parts = []
    for center, height, width in presses:
        _, slopes, change, distance = bump(center, height, width)
        depth = np.zeros(SHAPE) if read is None else read(change)
        for mask, weight in ((distance < 1.2 * width, 1.0), (distance > 5 * width, 0.3)):
            rows, cols = np.nonzero(mask)
            known = slopes[mask] if weight == 1 else np.zeros((len(rows), 2))
            parts.append((change[mask], cols, rows, known, np.full(len(rows), weight), depth[mask]))
    change, x, y, slopes, weight, depth = (np.concatenate([part[i] for part in parts]) for i in range(6))
    return Samples(change, x, y, slopes, weight, SHAPE, BACKGROUND, None if read is None else depth)


@pytest.fixture(scope="module")
def fitted():
    """A plain model and one by lights, of bumps that are all about as deep as they are steep."""
    rng = np.random.default_rng(5)
    places = [(x, y) for x in (14, 30, 48, 66, 82) for y in (14, 36, 58)]
    presses = [(place, rng.uniform(3.0, 4.5), rng.uniform(5, 7)) for place in places]
    samples = samples_of(presses)
    read = DepthByLightsModel.depth_reader(samples)
    return HierarchicalModel.fit(samples), DepthByLightsModel.fit(samples_of(presses, read))


def gain_between(model, center, height, width, inner, outer):
    """Slopes that are read over the true ones, in a ring of a bump; distances in widths."""
    _, slopes, change, distance = bump(center, height, width)
    read, sigma = model.prepare(BACKGROUND, SHAPE).gradients_from_color(change)
    assert sigma is None
    ring = (distance >= inner * width) & (distance < outer * width)
    return float(np.sum(read[ring] * slopes[ring]) / np.sum(slopes[ring] ** 2))


@pytest.mark.parametrize(("center", "height"), [((40.0, 30.0), 4.0), ((58.0, 44.0), 1.2)])
def test_gel_around_a_contact_is_no_longer_read_too_flat(fitted, center, height):
    plain, lit = (gain_between(model, center, height, 6.0, 1.8, 2.8) for model in fitted)
    assert plain < 0.96
    assert abs(lit - 1) < 0.4 * abs(plain - 1)


def test_the_middle_of_a_deep_contact_is_read_right_too(fitted):
    assert gain_between(fitted[1], (44.0, 33.0), 4.0, 6.0, 0.0, 1.0) == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize("response", [1.0, 0.7])
def test_what_depth_does_to_the_light_is_the_laws(response):
    lights = NearLightModel(LEDS_PX, MIXTURE, 2.0, response, SHAPE)
    x, y = np.array([10.0, 50.0, 80.0]), np.array([60.0, 30.0, 10.0])
    lighter, stronger = light_per_depth(lights, x, y)
    level, step = np.zeros((3, 2)), 1e-3

    def per_px(gradients):
        deeper, at_rest = (change_at(x, y, depth + 0 * x, gradients, response) for depth in (step, 0))
        return (deeper - at_rest) / SEEN / step

    np.testing.assert_allclose(lighter, per_px(level), atol=2e-4)
    grows, whole = np.zeros((3, 3)), np.zeros((3, 3))
    for slope in ([1e-3, 0.0], [0.0, 1e-3]):
        gradients = np.tile(slope, (3, 1))
        effect = change_at(x, y, 0 * x, gradients, response) / SEEN
        grows += effect * (per_px(gradients) - per_px(level))
        whole += effect**2
    np.testing.assert_allclose(stronger, grows / whole, rtol=0.05)


def test_lights_say_how_much_of_the_colours_they_explain(fitted):
    assert fitted[1].unexplained < 0.1
    samples = samples_of([((48, 36), 4.0, 6.0), ((20, 20), 3.0, 6.0)])
    others = np.random.default_rng(0).permutation(len(samples.x_px))
    mixed = replace(samples, color_change=samples.color_change[others])
    assert DepthByLightsModel.fit(mixed).unexplained > 0.5


def test_without_depths_it_is_the_plain_model():
    samples = samples_of([((48, 36), 4.0, 6.0), ((20, 20), 3.0, 6.0), ((70, 50), 3.0, 6.0)])
    model = DepthByLightsModel.fit(samples)
    np.testing.assert_array_equal(model.beside.nodes, HierarchicalModel.fit(samples).nodes)


def test_it_is_saved_and_named(fitted):
    model = fitted[1]
    again = DepthByLightsModel.from_arrays(*model.to_arrays())
    change = bump((30.0, 30.0), 2.0, 5.0)[2]
    frames = [m.prepare(BACKGROUND, SHAPE).gradients_from_color(change)[0] for m in (model, again)]
    np.testing.assert_array_equal(*frames)
    assert again.unexplained == model.unexplained
    assert not any(variant.in_auto for variant in DepthByLightsModel.variants(30))
    with pytest.raises(ValueError, match="Expected images of 72x96 px"):
        model.prepare(BACKGROUND, (96, 72))
