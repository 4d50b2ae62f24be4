"""ColorModel: the protocol of all color models, and the samples that they are fitted on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from types import NoneType
from typing import Any, ClassVar, Protocol, TypeVar, get_args, get_origin, get_type_hints, runtime_checkable

import numpy as np

from gelform.arrays import Array, Map, Numbers, Slopes
from gelform.image.background import PendingChange

T = TypeVar("T")


@dataclass(frozen=True)
class Samples:
    """Pixels whose gradient is known."""

    color_change: Array  # (N, 3) float32
    x_px: Array  # (N,) float32, pixel positions
    y_px: Array
    gradients: Array  # (N, 2) float64, mm/mm
    weight: Array  # (N,) float64, >= 0
    shape: tuple[int, int]  # (H, W) of the images they come from
    background: Array | None = None  # (H, W, 3) float32, for models that use the light at a place
    depth_px: Array | None = None  # (N,) float32, >= 0, from a plain model, for models that use it
    # What fits on these samples have in common, by the model; a model writes it here for its next fit.
    shared: dict[str, Any] = field(default_factory=dict, init=False, repr=False, compare=False)


class PreparedColorModel(Protocol):
    """A color model ready for frames of one shape over one background."""

    def gradients_from_color(self, color_change: Map) -> tuple[Slopes, Slopes | None]:
        """Gradients (H, W, 2) of a color change (H, W, 3), and their standard deviation or None."""
        ...


@runtime_checkable
class OnePassModel(Protocol):
    """Addition to `PreparedColorModel`: its kernel also computes the color change."""

    def gradients_in_one_pass(self, pending: PendingChange, out: Map) -> tuple[Slopes, Slopes | None]:
        """As `gradients_from_color`; the color change is written to `out` (H, W, 3)."""
        ...


@runtime_checkable
class AlbedoModel(Protocol):
    """Addition to `PreparedColorModel`: it gives the albedo besides the slopes."""

    def albedo_from_color(self, color_change: Map) -> Map:
        """Albedo (H, W) relative to the gel at rest."""
        ...


def gradients_from_pending(
    model: PreparedColorModel, pending: PendingChange, out: Map
) -> tuple[Slopes, Slopes | None]:
    """Gradients and their deviation, in one pass if the model can; the color change is written to `out` (H, W, 3)."""
    if isinstance(model, OnePassModel):
        return model.gradients_in_one_pass(pending, out)
    return model.gradients_from_color(pending.write(out))


class ColorModel(Protocol):
    """A fitted color model; immutable."""

    name: ClassVar[str]  # for users and calibration files
    change_offset: ClassVar[float]  # gray levels c of `(I - I0)/(I0 + c)`; 0 for laws of physics

    def gradients_at(self, color_change: Array, x_px: Array, y_px: Array) -> Numbers:
        """Gradients (N, 2) of scattered pixels."""
        ...

    def prepare(self, background: Array, shape: tuple[int, int]) -> PreparedColorModel:
        """Everything that does not depend on the frame, computed once."""
        ...

    def to_arrays(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """Arrays and JSON-able settings, from which `from_arrays` makes the model again."""
        ...

    @classmethod
    def from_arrays(cls, arrays: dict[str, Array], settings: dict[str, Any]) -> ColorModel:
        """The model from `to_arrays`. Later additions have a default here, because older files stay readable."""
        ...


class Stored:
    """A dataclass that a file holds as arrays, and as settings that JSON has.

    Its fields are arrays, records of arrays (such as `Layers`), numbers, texts and tuples of them. A file lacks arrays that
    are None. A field with a default may be missing: older files stay readable.
    """

    def to_arrays(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """Arrays and settings, from which `from_arrays` makes the record again."""
        arrays: dict[str, Array] = {}
        settings: dict[str, Any] = {}
        for name, hint, _ in _fields(type(self)):
            value = getattr(self, name)
            if hasattr(hint, "to_arrays"):
                arrays |= value.to_arrays()
            elif get_origin(hint) is not np.ndarray:
                settings[name] = list(value) if isinstance(value, tuple) else value
            elif value is not None:
                arrays[name] = value
        return arrays, settings

    @classmethod
    def from_arrays(cls: type[T], arrays: dict[str, Array], settings: dict[str, Any]) -> T:
        """The record of `to_arrays`; KeyError, TypeError or ValueError: they make none."""
        values: dict[str, Any] = {}
        for name, hint, needed in _fields(cls):
            stored = arrays if get_origin(hint) is np.ndarray else settings
            if hasattr(hint, "from_arrays"):
                values[name] = hint.from_arrays(arrays)
            elif needed or stored.get(name) is not None:
                value, kinds = stored[name], get_args(hint)
                if get_origin(hint) is tuple:
                    if not isinstance(value, list) or (... not in kinds and len(value) != len(kinds)):
                        raise TypeError(f"Expected {name} as a list of {len(kinds)}, got {value!r}.")
                    value = tuple(value)
                values[name] = value
        return cls(**values)


def _fields(record: type) -> Iterator[tuple[str, Any, bool]]:
    """Name and type of each field, X for `X | None`, and whether a file must have it."""
    hints = get_type_hints(record)
    for one in fields(record):
        kinds = get_args(hints[one.name])
        yield one.name, kinds[0] if NoneType in kinds else hints[one.name], one.default is MISSING


class FittableColorModel(ColorModel, Protocol):
    """The additional methods of the classes in `COLOR_MODELS`: the fit, and the settings that calibration tries."""

    @classmethod
    def fit(cls, *samples: Any, **settings: Any) -> FittableColorModel:
        """`fit(samples, **settings)`, deterministic; the settings are the model's own, each with a default."""
        ...

    @classmethod
    def variants(cls, presses: int) -> Sequence[Mapping[str, Any]]:
        """Keywords of `fit` to try with a number of accepted presses, the simplest first; at least one."""
        ...


class Untuned:
    """A color model without settings to try, whatever the number of presses."""

    @classmethod
    def variants(cls, presses: int) -> list[dict[str, Any]]:
        """The class's only variant."""
        return [{}]


@runtime_checkable
class StartableModel(ColorModel, Protocol):
    """Addition to `ColorModel`: a fit can start from another unit's; `fit` takes it as `start`, and a `ridge`."""

    @property
    def degree(self) -> int:
        """Degree of the polynomial in color."""
        ...

    def of_other_unit(self, gain: Numbers, wider: float) -> StartableModel:
        """The model of a unit whose color changes are smaller by a gain (rows, columns, 3) at its nodes.

        Its pixels are `wider` times as wide on the gel.
        """
        ...

    def check_like(self, degree: int, shape: tuple[int, int]) -> None:
        """Raise a ValueError if a model of a degree and an image shape cannot start from this one."""
        ...


def check_image_shape(shape: tuple[int, int], own: tuple[int, int], *, made: str = "calibrated") -> None:
    """Raise a ValueError if a model is prepared for images of another size than its own."""
    if tuple(shape) != tuple(own):
        raise ValueError(f"Expected images of {own[0]}x{own[1]} px, as {made}, got {shape[0]}x{shape[1]}.")
