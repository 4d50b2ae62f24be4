"""Every public function of arrays, with each of its arguments replaced by something odd in turn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gelform
from hostile.budget import cases
from hostile.damage import ODD_VALUES, odd_arrays
from hostile.outcome import judge
from hostile.small_gel import LIGHTS, MM_PER_PX, SHAPE, Touch, background, calibration, depth_of, image_of

DEPTH = depth_of(Touch()).astype(np.float32)
GRADIENTS = gelform.gradients_from_depth(DEPTH, mm_per_px=MM_PER_PX)
NORMALS = gelform.normals_from_gradients(GRADIENTS)
IMAGE, REST = image_of(Touch()), background()
CHANGE = gelform.color_change_from_image(IMAGE, REST)
MASK = DEPTH > 0
WEIGHTS = np.where(MASK, 1.0, 0.5).astype(np.float32)
PITCH = {"mm_per_px": MM_PER_PX}


def gain(image: Any, background: Any) -> np.ndarray:
    return gelform.exposure_from_image(image, background).believed_gain


DOORS: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "image_from_frame": (gelform.image_from_frame, {"frame": IMAGE, "view": gelform.View()}),
    "color_change_from_image": (gelform.color_change_from_image, {"image": IMAGE, "background": REST}),
    "image_from_color_change": (gelform.image_from_color_change, {"color_change": CHANGE, "background": REST}),
    "exposure_from_image": (gain, {"image": IMAGE, "background": REST}),
    "background_from_frames": (gelform.background_from_frames, {"frames": [IMAGE, IMAGE, IMAGE]}),
    "markers_from_image": (gelform.markers_from_image, {"image": IMAGE, "background": REST}),
    "normals_from_image": (gelform.normals_from_image, {"image": NORMALS @ LIGHTS.T, "lights": LIGHTS}),
    "image_from_normals": (gelform.image_from_normals, {"normals": NORMALS, "lights": LIGHTS, "albedo": WEIGHTS}),
    "lights_from_normals": (
        gelform.lights_from_normals,
        {"image": np.maximum(NORMALS @ LIGHTS.T, 0), "normals": NORMALS, "albedo": WEIGHTS},
    ),
    "normals_from_gradients": (gelform.normals_from_gradients, {"gradients": GRADIENTS}),
    "gradients_from_normals": (gelform.gradients_from_normals, {"normals": NORMALS}),
    "gradients_from_depth": (gelform.gradients_from_depth, {"depth_mm": DEPTH, **PITCH}),
    "depth_from_gradients": (gelform.depth_from_gradients, {"gradients": GRADIENTS, **PITCH}),
    "integrate": (
        gelform.integrate,
        {"gradients": GRADIENTS, **PITCH, "weights": WEIGHTS, "mask": MASK, "anchor": WEIGHTS, "zero": MASK},
    ),
    "edge_residuals": (gelform.edge_residuals, {"depth_mm": DEPTH, "gradients": GRADIENTS, **PITCH}),
    "contact_from_depth": (gelform.contact_from_depth, {"depth_mm": DEPTH, **PITCH}),
    "Reconstructor": (lambda frame: gelform.Reconstructor(calibration())(frame), {"frame": IMAGE}),
}  # fmt: skip


def as_numbers(value: Any) -> np.ndarray | None:
    """The numbers that something holds, or None: same numbers in other clothes have to give the same result."""
    try:
        array = np.ma.getdata(value) if isinstance(value, np.ma.MaskedArray) else np.asarray(value)
        return None if np.ma.isMaskedArray(value) or array.dtype.kind not in "fiub" else array.astype(float)
    except (TypeError, ValueError, RuntimeError):
        return None


def values_of(result: Any) -> list[np.ndarray]:
    """The arrays of a result, for comparison."""
    if isinstance(result, np.ndarray):
        return [result]
    if isinstance(result, tuple):
        return [array for one in result for array in values_of(one)]
    return [value for value in vars(result).values() if isinstance(value, np.ndarray)]


def difference(door: str, got: Any, argument: str, odd: Any) -> str | None:
    """Where the odd argument holds the right numbers, the result has to be the right one."""
    function, arguments = DOORS[door]
    right, numbers = as_numbers(arguments[argument]), as_numbers(odd)
    if right is None or numbers is None or right.shape != numbers.shape or not np.allclose(right, numbers):
        return None
    for one, other in zip(values_of(got), values_of(function(**arguments))):
        if not one.size and one.shape == other.shape:
            continue
        if one.shape != other.shape or not np.allclose(one, other, atol=2e-2 * max(1.0, np.abs(other).max())):
            return "the same numbers give another result"
    return None


@pytest.mark.parametrize("door", DOORS)
def test_odd_arguments(door):
    function, arguments = DOORS[door]

    @cases(38)
    @given(argument=st.sampled_from(sorted(arguments)), which=st.integers(0, 80))
    def of_any_kind(argument, which):
        value = arguments[argument]
        odd = odd_arrays(value) if isinstance(value, np.ndarray) else list(ODD_VALUES)
        with np.errstate(all="ignore"):
            chosen = odd[which % len(odd)]
        judge(
            f"{door}({argument}=odd {which % len(odd)})",
            lambda: function(**{**arguments, argument: chosen}),
            lambda got: difference(door, got, argument, chosen),
        )

    of_any_kind()


SETTINGS = {
    "integrate": (
        lambda **s: gelform.integrate(GRADIENTS, mm_per_px=MM_PER_PX, **s),
        ("solver", "zero", "level", "weights", "anchor", "mask"),
    ),
    "contact_from_depth": (
        lambda **s: gelform.contact_from_depth(DEPTH, mm_per_px=MM_PER_PX, **s),
        ("min_depth_mm", "noise_factor", "rim_fraction", "min_area_mm2"),
    ),
    "ChangeSettings": (
        lambda **s: gelform.color_change_from_image(IMAGE, REST, gelform.ChangeSettings(**s)),
        ("method", "offset", "blur_px", "crosstalk", "response"),
    ),
    "View": (
        lambda **s: gelform.image_from_frame(IMAGE, gelform.View(**{"frame_shape": SHAPE, **s})),
        ("frame_shape", "crop", "flip", "image_shape", "lens"),
    ),
    "Reconstructor": (
        lambda **s: gelform.Reconstructor(**{"calibration": calibration(), **s})(IMAGE),
        ("calibration", "background", "solver", "depth_sigma"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("door", SETTINGS)
def test_odd_settings(door):
    function, names = SETTINGS[door]

    @cases(50)
    @given(name=st.sampled_from(names), which=st.integers(0, len(ODD_VALUES) + 2))
    def of_any_kind(name, which):
        odd = (*ODD_VALUES, 1e9, 3e38, float("nan"))[which]
        judge(f"{door}({name}={odd!r:.30})", lambda: function(**{name: odd}))

    of_any_kind()
