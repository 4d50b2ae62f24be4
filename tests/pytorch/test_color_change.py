"""The color change of a batch equals that of the numpy path: blur, response, crosstalk and exposure."""

import numpy as np
import pytest

from gelform.image.background.change import ChangeSettings, PreparedBackground

torch = pytest.importorskip("torch", reason="needs the extra 'torch'")
from gelform.torch.color_change import ColorChange  # noqa: E402

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
    "shape", [(60, 80), (240, 320)], ids=["means_of_2x2_round_up", "means_of_8x8_round_to_even"]
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
    found = ColorChange(background, settings, True)(torch.from_numpy(image).permute(2, 0, 1)[None])[0]
    np.testing.assert_allclose(found.permute(1, 2, 0), expected, atol=2e-5)
    plain = ColorChange(background, settings, False)(torch.from_numpy(image).permute(2, 0, 1)[None])[0]
    np.testing.assert_allclose(plain.permute(1, 2, 0), prepared.change(image), atol=2e-5)
