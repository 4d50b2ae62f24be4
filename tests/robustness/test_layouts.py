"""The same numbers in another layout of memory give the same result, through every door that takes arrays.

Cropped and transposed views, a negative stride, read-only and big-endian arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest

import gelform
from gelform.calibration.starters import load_starter
from gelform.depth.solvers import SOLVERS
from gelform.exchange.exporters.surface import levels_from_depth
from gelform.image.view import frame_px_from_image_px, image_px_from_frame_px
from gelform.result.maps import MAPS
from gelform.result.metrics import areal_roughness
from gelform.robots.lerobot_depth import lerobot_levels_from_depth
from hostile.doors import (
    ALL_ODD,
    CALIBRATION,
    DEPTH,
    EXPORTS,
    GRADIENTS,
    IMAGE,
    MASK,
    MM_PER_PX,
    REST,
    WEIGHTS,
    called,
    right_arguments,
)


def cropped(array: np.ndarray) -> np.ndarray:
    """In the middle of something larger."""
    larger = np.zeros([size + 2 for size in array.shape], array.dtype)
    view = larger[(slice(1, -1),) * array.ndim]
    view[...] = array
    return view


def read_only(array: np.ndarray) -> np.ndarray:
    array = array.copy()
    array.flags.writeable = False
    return array


LAYOUTS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "cropped": cropped,
    "transposed": lambda array: array.T.copy().T,
    "mirrored": lambda array: np.flip(np.flip(array).copy()),
    "read-only": read_only,
    "big-endian": lambda array: array.astype(array.dtype.newbyteorder(">")),
}


def laid_out(value: Any, layout: Callable[[np.ndarray], np.ndarray]) -> Any:
    """Arrays, and lists or pairs of them, in a layout; everything else as it is."""
    if isinstance(value, np.ndarray):
        return layout(value)
    if isinstance(value, gelform.Frame):
        return replace(value, image=layout(value.image))
    if isinstance(value, (list, tuple)) and value and isinstance(value[0], (np.ndarray, gelform.Frame)):
        return type(value)(laid_out(one, layout) for one in value)
    return value


def numbers_of(value: Any) -> list[Any]:
    """The numbers, texts and arrays of a result, in order."""
    if isinstance(value, gelform.Reconstruction):
        return [value.health, value.numbers, *(getattr(value, name) for name in MAPS)]
    if isinstance(value, dict):
        return [one for each in value.values() for one in numbers_of(each)]
    if isinstance(value, (list, tuple)):
        return [one for each in value for one in numbers_of(each)]
    if is_dataclass(value):
        return [one for each in fields(value) for one in numbers_of(getattr(value, each.name))]
    return [value] if isinstance(value, (np.ndarray, np.generic, str, float, int)) else []


STARTER = load_starter("gelsight-mini").calibration
RECONSTRUCT = gelform.Reconstructor(CALIBRATION)
EDGES = WEIGHTS[:, 1:].copy(), WEIGHTS[1:].copy()
STACK = np.stack([GRADIENTS, GRADIENTS[::-1]])
POINTS = np.array([[20.5, 30.0], [41.0, 12.0]])
# Methods, and what the table of the exports does not give: their options in another form, and functions of modules.
MORE: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "areal_roughness": (areal_roughness, {"depth_mm": DEPTH, "mm_per_px": MM_PER_PX, "mask": MASK}),
    "Calibration.color_from_gradients": (
        STARTER.color_from_gradients, {"gradients": np.resize(GRADIENTS, (*STARTER.image_shape, 2))},
    ),
    "frame_px_from_image_px": (frame_px_from_image_px, {"points_px": POINTS, "view": gelform.View()}),
    "image_px_from_frame_px": (image_px_from_frame_px, {"points_px": POINTS, "view": gelform.View()}),
    "integrate edges": (
        gelform.integrate, {"gradients": GRADIENTS, "mm_per_px": MM_PER_PX, "weights": EDGES},
    ),
    "integrate a stack": (
        gelform.integrate,
        {"gradients": STACK, "mm_per_px": MM_PER_PX, "weights": np.stack([WEIGHTS] * 2), "mask": MASK, "zero": MASK},
    ),
    "levels_from_depth": (levels_from_depth, {"depth_mm": DEPTH, "known": MASK}),
    "lerobot_levels_from_depth": (lerobot_levels_from_depth, {"depth_mm": DEPTH}),
    "MarkerTracker.update": (
        lambda image, background: gelform.MarkerTracker(background, MM_PER_PX).update(image),
        {"image": IMAGE, "background": REST},
    ),
    "Reconstruction.depth_difference_sigma": (
        RECONSTRUCT(IMAGE).depth_difference_sigma, {"region": MASK},
    ),
    "Reconstructor": (RECONSTRUCT, {"frame": IMAGE}),
    "Reconstructor.explain": (lambda image: vars(RECONSTRUCT.explain(image)), {"image": IMAGE}),
    "Reconstructor.from_image": (RECONSTRUCT.from_image, {"image": IMAGE}),
    "Reconstructor.from_image of floats": (RECONSTRUCT.from_image, {"image": IMAGE.astype(np.float64)}),
    "Reconstructor.with_background": (
        lambda background: RECONSTRUCT.with_background(background)(IMAGE), {"background": REST},
    ),
}  # fmt: skip
for solver in SOLVERS:
    free = not SOLVERS[solver].takes_weights
    given = {} if free else {"weights": WEIGHTS, "mask": MASK, "anchor": WEIGHTS}
    settings = {"gradients": GRADIENTS, "mm_per_px": MM_PER_PX, "zero": MASK, "solver": solver}
    MORE[f"integrate by {solver}"] = gelform.integrate, settings | given


def export(name: str) -> Callable[..., Any]:
    return lambda **given: called(name, given)


def has_arrays(arguments: dict[str, Any]) -> bool:
    return any(laid_out(value, lambda array: None) is not value for value in arguments.values())


DOORS = {name: (export(name), right_arguments(name)) for name in EXPORTS.keys() - ALL_ODD}
DOORS = {name: door for name, door in sorted((DOORS | MORE).items()) if has_arrays(door[1])}


def outcome(door: Callable[..., Any], arguments: dict[str, Any]) -> Any:
    """What the call gives; for a door that reads a file, of which there is none here, what it says."""
    try:
        return numbers_of(door(**arguments))
    except gelform.GelformError as problem:
        return str(problem)


SLOW = {"picture", "Calibration.color_from_gradients"}  # draws, or has large arrays
EACH = [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in DOORS]


@pytest.mark.parametrize("name", EACH)
def test_any_layout_gives_the_same(name):
    door, arguments = DOORS[name]
    wanted = outcome(door, arguments)
    for layout, of in LAYOUTS.items():
        got = outcome(door, {key: laid_out(value, of) for key, value in arguments.items()})
        assert len(got) == len(wanted)
        for one, other in zip(got, wanted):
            np.testing.assert_array_equal(one, other, err_msg=f"{name}, {layout}")


class Elsewhere:
    """A tensor on another device, say, which does not become an array."""

    def __array__(self, *_: Any, **__: Any) -> np.ndarray:
        raise RuntimeError("on another device")


@pytest.mark.parametrize("name", DOORS)
def test_what_does_not_become_an_array_is_named(name):
    """What the object raised is the cause of gelform's own error."""
    door, arguments = DOORS[name]
    for key, value in arguments.items():
        foreign = laid_out(value, lambda array: Elsewhere())
        if foreign is value:
            continue
        with pytest.raises((TypeError, ValueError), match=r"Expected .*on another device") as said:
            door(**arguments | {key: foreign})
        assert isinstance(said.value.__cause__, RuntimeError), key
