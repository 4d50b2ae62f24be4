"""Each step of a batch equals the numpy path's: medians, color change, color models, step, depth; derivatives are exact.

The module equals the numpy path, batch by batch, and its derivatives equal finite differences.

The code of docs/torch.md.
"""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import gelform
from gelform.depth import coarse
from gelform.depth.solvers.dct import DctSolver
from gelform.errors import CalibrationError
from gelform.foundations.checks import HIGHEST_SLOPE
from gelform.foundations.filters import medians_where as by_kernel
from gelform.image.background import ChangeSettings, PreparedBackground
from gelform.slopes.color_models import HierarchicalModel, LambertianModel, NearLightModel
from gelform.slopes.color_models.forward_response import (
    CLIPPED_STEP_SIGMA,
    TERMS,
    ForwardResponse,
    PreparedStep,
)
from gelform.slopes.color_models.seam import node_positions

torch = pytest.importorskip("torch", reason="needs the extra 'torch'")

from gelform.torch import Reconstruct  # noqa: E402
from gelform.torch.reconstruct import (  # noqa: E402
    CoarseDepthModule,
    ColorChange,
    ForwardStep,
    PoissonDepth,
    gradients_module,
    medians_where,
    planes,
)


@pytest.mark.parametrize("share", [None, 0.5, 0.03, 0.0])
def test_medians_are_the_kernels(share):
    rng = np.random.default_rng(2)
    maps = rng.normal(size=(3, 14, 15, 2)).astype(np.float32)
    chosen = None if share is None else rng.random((3, 14, 15)) < share
    given = None if chosen is None else torch.from_numpy(chosen)[:, None]
    found = medians_where(torch.from_numpy(maps).permute(0, 3, 1, 2), given)
    assert found.shape == (3, 2, 1, 1)
    for k, one in enumerate(maps):
        expected, _ = by_kernel(one, None if chosen is None else chosen[k])
        np.testing.assert_allclose(found[k, :, 0, 0], expected, rtol=1e-6)


@pytest.mark.parametrize("pitch", [(0.1, 0.1), (0.1, 0.13)], ids=["square", "oblong"])
@pytest.mark.parametrize("shape", [(7, 9), (8, 6), (1, 5), (132, 176)])
def test_the_solve_is_that_of_the_dct_solver(shape, pitch):
    gradients = np.random.default_rng(0).standard_normal((*shape, 2)).astype(np.float32)
    expected = DctSolver(shape, pitch)(gradients).depth_mm
    found = PoissonDepth(shape, pitch)(batch(gradients))[0]
    np.testing.assert_allclose(found, expected, atol=2e-5 * np.ptp(expected))


MIXED = ((1.0, 0.1, 0.0), (0.05, 1.0, 0.08), (0.0, 0.1, 1.0))


@pytest.mark.parametrize(
    "settings",
    [
        ChangeSettings(),
        ChangeSettings("subtract", blur_px=1.5),
        ChangeSettings(blur_px=0.8, crosstalk=MIXED, response=0.6),
    ],
    ids=["plain", "subtract", "undone"],
)
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
@pytest.mark.parametrize(
    "shape",
    [(60, 80), (240, 320), (132, 176)],
    ids=["means_of_2x2_round_up", "means_of_8x8_round_to_even", "sums_of_fractions_round_as_they_come"],
)
def test_it_is_the_numpy_paths(settings, dtype, shape):
    rng = np.random.default_rng(1)
    background = rng.uniform(80, 150, (*shape, 3)).astype(np.float32)
    image = background * np.array([1.06, 1.04, 0.97]) + rng.normal(0, 2, background.shape)
    image[20:40, 30:50] += rng.uniform(-30, 30, (20, 20, 3))
    image = image.round().astype(dtype)
    prepared = PreparedBackground(background, settings)
    light, _ = prepared.compare(image)
    assert light.is_known
    assert light.is_plain
    expected = prepared.change(image, light)
    for compensate, wanted in ((True, expected), (False, prepared.change(image))):
        found = ColorChange(background, settings, compensate)(torch.from_numpy(image).permute(2, 0, 1)[None])
        np.testing.assert_allclose(found[0].permute(1, 2, 0), wanted, atol=2e-5)


SHAPE = 12, 16
BACKGROUND = np.full((*SHAPE, 3), 90.0, np.float32)
LIGHTS = np.array([[0.5, 0.1, 1], [-0.3, 0.4, 1], [-0.2, -0.6, 1]])
FROM_ONE_SIDE = np.array([[0.5, 0.1, 1], [0.4, 0.5, 1], [0.6, -0.4, 1]])  # some pixels get the largest slope
POSITIONS_PX = np.array([[0.0, 20, 9], [18, -9, 8], [-17, -8, 10]])


@pytest.mark.parametrize(
    "model",
    [
        LambertianModel(LIGHTS, 0.8),
        LambertianModel(FROM_ONE_SIDE, 1.0),
        NearLightModel(POSITIONS_PX, np.eye(3) + 0.1, 2.0, 1.0, SHAPE),
    ],
    ids=["lambertian", "in_shadow", "near_light"],
)
def test_photometric_stereo_is_the_models_own(model):
    change = np.random.default_rng(0).uniform(-0.3, 0.5, (*SHAPE, 3)).astype(np.float32)
    y_px, x_px = (axis.ravel() for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])
    expected = model.gradients_at(change.reshape(-1, 3), x_px, y_px).reshape(*SHAPE, 2)
    found = gradients_module(model, BACKGROUND)(batch(change))[0]
    np.testing.assert_allclose(found.permute(1, 2, 0), expected, rtol=2e-4, atol=1e-5)


@pytest.mark.parametrize("steepest", [HIGHEST_SLOPE, 0.2])
def test_a_polynomial_is_the_models_own(steepest):
    model = HierarchicalModel(np.random.default_rng(3).normal(0, 0.3, (2, 2, 19, 2)), 3, SHAPE, steepest)
    change = np.random.default_rng(0).uniform(-0.3, 0.5, (*SHAPE, 3)).astype(np.float32)
    expected, over = model.prepare(BACKGROUND, SHAPE).gradients_from_color(change)
    assert (over is None) == (steepest == HIGHEST_SLOPE)
    found = gradients_module(model, BACKGROUND)(batch(change))[0]
    np.testing.assert_allclose(found.permute(1, 2, 0), expected, atol=1e-5)


def test_a_model_without_such_a_form_is_named():
    with pytest.raises(CalibrationError, match="--model hierarchical"):
        gradients_module(SimpleNamespace(name="network"), BACKGROUND)


UNTOUCHED = 0.01


def response(shape, seed=0, scale=1.0):
    """Of coefficients as large as those of sensors, all of them there, and channels that are off together."""
    rng = np.random.default_rng(seed)
    rows, columns = (len(axis) for axis in node_positions(shape))
    order = np.array([1, 1, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 4, 1, 2, 2])
    assert len(order) == TERMS
    nodes = scale * rng.normal(size=(rows, columns, TERMS, 3)) * 0.15 / 3.0 ** (order - 1)[:, None]
    mixed = rng.normal(size=(3, 3))
    return ForwardResponse(nodes, 1e-4 * (mixed @ mixed.T + np.eye(3)), shape, (0.01, 0.15))


def frame(shape, center, seed=1, tilt=0.0):
    """Color change (H, W, 3) and slopes (H, W, 2) of a bump 6 px high on gel that tilts a little, with noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    dx, dy = x - center[0], y - center[1]
    slopes = np.stack([-dx, -dy], axis=-1) * (6 / 100 * np.exp(-(dx**2 + dy**2) / 200))[..., None]
    change = slopes @ rng.uniform(-1, 1, (2, 3)) + 2 * tilt + rng.normal(0, 0.004, (*shape, 3))
    slopes += tilt + rng.normal(0, 0.003, slopes.shape)
    return change.astype(np.float32), slopes.astype(np.float32)


def batch(*maps):
    return torch.stack([planes(one) for one in maps])


def slopes_after(forward, change, read):
    """The numpy path's slopes after a step with the frame's depth."""
    return PreparedStep(forward)(
        change, read, coarse.CoarseDepth(read.shape[:2], UNTOUCHED)(change, read)
    ).gradients


@pytest.mark.parametrize("shape", [(64, 96), (61, 90), (17, 33)], ids=["divided", "not_divided", "small"])
@pytest.mark.parametrize("seed", [0, 5])
def test_steps_are_the_numpy_paths(shape, seed):
    """Of two frames at once; the slopes change by what a step may do."""
    forward = response(shape, seed)
    frames = [frame(shape, (20, 9)), frame(shape, (12.5, shape[0] / 2), seed=2)]
    changes, slopes = (batch(*maps) for maps in zip(*frames))
    found = ForwardStep(forward, UNTOUCHED)(changes, slopes)
    for (change, read), one in zip(frames, found):
        expected = slopes_after(forward, change, read)
        assert 0.005 < np.abs(expected - read).max() <= CLIPPED_STEP_SIGMA * (1 + 1e-5)
        np.testing.assert_allclose(one.permute(1, 2, 0), expected, atol=1e-4 * np.abs(expected).max())


def test_no_step_is_longer_than_the_longest():
    """Of colors that no slope gives: as far, and in the same direction, as the numpy path goes."""
    shape = (30, 45)
    forward = response(shape, scale=0.5)
    change, read = frame(shape, (20, 15))
    change[5:12, 30:40] += np.array([0.9, -0.7, 0.8], np.float32)
    found = ForwardStep(forward, UNTOUCHED)(batch(change), batch(read))[0].permute(1, 2, 0).numpy()
    length = np.linalg.norm(found - read, axis=-1)
    assert length.max() == pytest.approx(CLIPPED_STEP_SIGMA, rel=1e-4)
    expected = slopes_after(forward, change, read)
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_a_gel_at_rest_has_derivatives():
    """No slope and no color: the step's length is 0, which has none of itself."""
    shape = (9, 12)
    step = ForwardStep(response(shape), UNTOUCHED)
    change = torch.zeros(1, 3, *shape, requires_grad=True)
    stepped = step(change, torch.zeros(1, 2, *shape))
    assert stepped.abs().max() < 1e-6
    (derivative,) = torch.autograd.grad(stepped.sum(), change)
    assert derivative.isfinite().all()
    assert derivative.abs().max() > 0.01


@pytest.mark.parametrize(
    ("shape", "untouched"),
    [((64, 96), 0.01), ((61, 90), 0.01), ((7, 33), 0.01), ((61, 90), 1e-6)],
    ids=["divided", "not_divided", "low", "the_least_changed"],
)
def test_depth_is_the_numpy_paths(shape, untouched):
    frames = [frame(shape, center, 7, 0.01) for center in ((20, 5), (12.5, shape[0] / 2))]
    ours, theirs = CoarseDepthModule(shape, untouched), coarse.CoarseDepth(shape, untouched)
    changes, slopes = (batch(*maps) for maps in zip(*frames))
    found = ours(slopes, ours.rest(changes))
    for one, depth, full in zip(frames, found[:, 0], ours.in_full(found)[:, 0]):
        expected = theirs(*one)
        assert expected.max() > 0.3
        np.testing.assert_allclose(depth, expected, atol=2e-5 * expected.max())
        everywhere = cv2.resize(expected, shape[::-1], interpolation=cv2.INTER_LINEAR)
        np.testing.assert_allclose(full, everywhere, atol=2e-5 * expected.max())


def batch_of(images):
    return torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2)


@pytest.fixture(scope="module")
def images(simulated):
    """Presses, one of them brighter, one with a touch nearly everywhere, and the untouched gel."""
    pressed = [press.image for press in simulated.presses[:4]]
    brighter = np.clip(pressed[0] * np.array([1.08, 1.05, 1.1]), 0, 255).round().astype(np.uint8)
    return [*pressed, brighter, simulated.background.round().astype(np.uint8)]


def calibration_of(name, request):
    """That of the shared presses, whose forward response takes a step; without it; or with an image that is undone first."""
    other = {"lambertian": "lambertian_calibration", "polynomial": "polynomial_calibration"}
    made = request.getfixturevalue(other.get(name, "calibration"))
    if name == "without_a_step":
        return replace(made, forward=replace(made.forward, step_sigma=None))
    if name == "without_a_response":
        return replace(made, forward=None)
    assert made.forward.step_sigma is not None
    if name == "crosstalk":
        mixed = ((1.0, 0.1, 0.0), (0.05, 1.0, 0.08), (0.0, 0.1, 1.0))
        return replace(made, change=replace(made.change, crosstalk=mixed, response=0.8))
    if name == "deep":
        nodes = made.forward.nodes.copy()
        nodes[:, :, -3:] *= 8  # as if the light changed much with the depth
        return replace(made, forward=replace(made.forward, nodes=nodes))
    return made


@pytest.mark.parametrize(
    "name",
    ["auto", "lambertian", "polynomial", "crosstalk", "deep", "without_a_step", "without_a_response"],
)
def test_it_is_the_numpy_path(request, name, images):
    calibration = calibration_of(name, request)
    reconstruct = gelform.Reconstructor(calibration)
    slopes = [reconstruct.record(image).slopes for image in images]
    found = Reconstruct(calibration)(batch_of(images))
    expected = [
        gelform.integrate(
            one.gradients, mm_per_px=calibration.mm_per_px or 1.0, zero=one.at_rest, solver="dct"
        ).depth_mm
        for one in slopes
    ]
    peak = max(np.abs(depth).max() for depth in expected)
    tolerance = 2e-4 if name == "crosstalk" else 1e-4  # its inverse makes more of the last bits
    for k, (depth, one) in enumerate(zip(expected, slopes)):
        np.testing.assert_allclose(found.depth_mm[k, 0], depth, atol=tolerance * peak)
        np.testing.assert_allclose(found.gradients[k].permute(1, 2, 0), one.gradients, atol=3e-4)


@pytest.mark.parametrize("name", ["auto", "deep", "without_a_step"])
def test_an_image_is_the_same_alone_and_in_a_batch(request, name, images, monkeypatch):
    monkeypatch.setattr("gelform.torch.reconstruct.CPU_FRAMES", len(images))  # at once, as on other devices
    module = Reconstruct(calibration_of(name, request))
    together = module(batch_of(images)).depth_mm
    for k in range(len(images)):
        alone = module(batch_of(images[k : k + 1])).depth_mm[0]
        np.testing.assert_allclose(alone, together[k], atol=1e-6)


@pytest.mark.parametrize("name", ["auto", "deep", "without_a_step"])
def test_derivatives_are_those_of_differences(request, name, images):
    """Of a sum of depths with random weights, along random changes of the image, in double precision."""
    module = Reconstruct(calibration_of(name, request), compensate_exposure=False).double()
    generator = torch.Generator().manual_seed(0)
    # In the first image, a median changes its sample at once.
    image = batch_of(images[1:2]).double().requires_grad_()
    weights = torch.randn(image.shape[2:], generator=generator, dtype=torch.float64)
    (slope,) = torch.autograd.grad((module(image).depth_mm * weights).sum(), image)
    for _ in range(3):
        along = torch.randn(image.shape, generator=generator, dtype=torch.float64)
        along[:, :, ::8, ::8] = 0  # those decide what is untouched, by medians and a threshold
        step = 1e-7 * along  # at 1e-5 medians of the frame's depth are already those of other samples
        plus, minus = ((module(image + sign * step).depth_mm * weights).sum() for sign in (1, -1))
        expected = (plus - minus).item() / 2e-7
        assert (slope * along).sum().item() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("name", ["auto", "deep", "without_a_step"])
def test_it_moves_and_is_saved_as_modules_are(request, name, images):
    module = Reconstruct(calibration_of(name, request))
    again = Reconstruct(calibration_of(name, request))
    again.load_state_dict(module.state_dict())
    kept = module.to("meta").state_dict()
    assert kept
    assert all(buffer.device.type == "meta" for buffer in kept.values())
    assert again.double()(batch_of(images[:1])).depth_mm.dtype == torch.float64


def test_wrong_input_is_named(calibration, images):
    with pytest.raises(ValueError, match="Move the channels first"):
        Reconstruct(calibration)(torch.from_numpy(np.stack(images)))


PAGE = Path(__file__).parents[2] / "docs/torch.md"


def test_the_code_of_the_page_runs(calibration, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    calibration.save("mini.npz")
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    exec(compile(code, str(PAGE), "exec"), {})
