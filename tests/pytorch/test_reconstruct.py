"""The module equals the numpy path, batch by batch, and its derivatives equal finite differences.

The code of docs/torch.md.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gelform

torch = pytest.importorskip("torch", reason="needs the extra 'torch'")

from gelform.torch import Reconstruct  # noqa: E402


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
    reconstruct = gelform.Reconstructor(calibration, solver="dct")
    expected = [reconstruct.from_image(image) for image in images]
    found = Reconstruct(calibration)(batch_of(images))
    peak = max(np.abs(one.depth_mm).max() for one in expected)
    tolerance = 2e-4 if name == "crosstalk" else 1e-4  # its inverse makes more of the last bits
    for k, one in enumerate(expected):
        np.testing.assert_allclose(found.depth_mm[k, 0], one.depth_mm, atol=tolerance * peak)
        np.testing.assert_allclose(found.gradients[k].permute(1, 2, 0), one.observed_gradients, atol=3e-4)


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
    image = (
        batch_of(images[1:2]).double().requires_grad_()
    )  # in the first, a median changes its sample at once
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
