"""Calibration: everything that adapts the ideal model to one sensor with one gel, saved as one .npz file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from os import PathLike
from typing import Any

import cv2
import numpy as np

from gelform.arrays import MIB, Array, Map, Numbers
from gelform.depth.force import ForceModel
from gelform.errors import CalibrationError, Finding
from gelform.foundations.checks import (
    check_choice,
    check_gel_thickness,
    check_gradients,
    check_image,
    check_mm_per_px,
    check_positive,
    check_values,
    check_within,
)
from gelform.foundations.files import (
    damaged,
    digest_of,
    kind_of_npz,
    picture_bytes,
    read_npz,
    shown_in_notebook,
    write_npz,
)
from gelform.image.agreement import background_digest
from gelform.image.background import ChangeSettings
from gelform.image.view import MAX_PIXELS, THUMBNAIL_PX, View, as_levels
from gelform.slopes.color_models import COLOR_MODELS, IMPORTED_MODELS, ColorModel, ForwardResponse
from gelform.slopes.sigma import SlopeSigma

KIND, FORMAT_VERSION = "gelform calibration", 1


@dataclass(frozen=True, eq=False)
class CalibrationSettings(Mapping[str, Any]):
    """The inputs and choices of a calibration; also a mapping of those that are known, by their names in files."""

    contact_radius_ratio: float | None = None  # radius of the contact edge over that of the visible rim
    step_ridge: float | None = None  # ridge of the forward response that the step of slopes uses
    start: str | None = None  # digest of the calibration of another unit from which this one began
    presses: int | None = None  # number of presses used
    response: float | None = None  # exponent of the camera's response curve
    camera: Mapping[str, Any] | None = None  # settings of the camera, as they were read back
    scale_source: str | None = None  # source of mm_per_px
    lens: str | None = None  # source of distortion and perspective
    gel_thickness_mm: float | None = None  # thickness of the gel at rest, mm
    crosstalk: str | None = None  # description of the crosstalk that is removed before the color model
    relaxation_mm: float | None = None  # length over which the gel falls off around a contact, mm
    place_error: float | None = None  # of a ball's center over its displacement, for motions' covariance
    image_noise: Sequence[float] | None = None  # (3,) deviation of a pixel of an image, gray levels
    # Only if other units of the make were calibrated and this one was not: the make (`sensor`), the relative standard
    # deviation of slopes between units (`spread`), and the `units`.
    starter: Mapping[str, Any] | None = None
    findings: Sequence[Sequence[Any]] | None = None  # about the background: name, message and figure of each
    # Settings of the color model, options of an importer, and values that other releases wrote.
    others: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> CalibrationSettings:
        """Make settings from the names and values of a file."""
        known = {name: stored[name] for name in _SETTING_NAMES if name in stored}
        return cls(**known, others={name: v for name, v in stored.items() if name not in known})

    def _there(self) -> dict[str, Any]:
        known = {name: getattr(self, name) for name in _SETTING_NAMES}
        return {name: value for name, value in known.items() if value is not None} | dict(self.others)

    def __getitem__(self, name: str) -> Any:
        return self._there()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._there())

    def __len__(self) -> int:
        return len(self._there())


_SETTING_NAMES = [entry.name for entry in fields(CalibrationSettings) if entry.name != "others"]


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """A calibration of one sensor with one gel; it fits no other.

    Attributes
    ----------
    sensor_name, serial, gel_id : name of the sensor, its serial number, and the gel
    view : conversion of frames to images; identity if the calibration used images as they are
    image_shape : (H, W)
    mm_per_px, mm_per_px_sigma : mm per pixel, and its standard deviation if known; if mm_per_px is None (an
        imported calibration without a scale), results have gradients and depth_px, but no depth_mm
    background : (H, W, 3) float32, background image
    background_noise : (3,) standard deviation of a background pixel, gray levels
    change : conversion of an image to a color change
    color_model : color -> gradients
    forward : gradients -> color, fitted on the same presses; None in an import without it
    slope_sigma : standard deviation of the slopes, and their correlation length; None if unknown
    untouched_change : a smaller color change means that nothing touches
    held_out : held-out errors, by name
    training_digests : SHA-256 of the images that were used, and of those that show the same presses again
    settings : inputs and choices of the calibration; a dict becomes a `CalibrationSettings`
    library_version, created_utc : version of gelform that made it, and the time
    force : converts touches to newtons; None if no loads were calibrated
    report : the CalibrationReport of the run that made it; not saved
    """

    sensor_name: str
    serial: str | None
    gel_id: str | None
    view: View
    image_shape: tuple[int, int]
    mm_per_px: float | None
    mm_per_px_sigma: float | None
    background: Map
    background_noise: Numbers
    change: ChangeSettings
    color_model: ColorModel
    forward: ForwardResponse | None
    slope_sigma: SlopeSigma | None
    untouched_change: float
    held_out: dict[str, float]
    training_digests: tuple[str, ...]
    settings: CalibrationSettings
    library_version: str
    created_utc: str
    force: ForceModel | None = None
    report: Any = None

    def __post_init__(self) -> None:
        if not isinstance(self.settings, CalibrationSettings):
            object.__setattr__(self, "settings", CalibrationSettings.from_dict(self.settings))

    def __repr__(self) -> str:
        return f"Calibration({', '.join(f'{name}: {value}' for name, value in self._figures().items())})"

    def _repr_html_(self) -> str:
        """A notebook's view of the calibration: its background image and its figures; nothing is fetched."""
        findings = ((finding.name, finding.message) for finding in self.findings)
        height, width = self.image_shape
        size = THUMBNAIL_PX, max(1, round(THUMBNAIL_PX * height / width))
        picture = cv2.resize(as_levels(self.background), size, interpolation=cv2.INTER_AREA)
        return shown_in_notebook("background", picture_bytes(picture), (*self._figures().items(), *findings))

    def _figures(self) -> dict[str, str]:
        height, width = self.image_shape
        figures = {
            "sensor": " ".join(filter(None, (self.sensor_name, self.serial, self.gel_id))),
            "size": f"{height}x{width} px",
            "scale": "unknown" if self.mm_per_px is None else f"{self.mm_per_px:.4g} mm per pixel",
            "color model": self.color_model.name,
        }
        if self.settings.presses is not None:
            figures["presses"] = str(self.settings.presses)
        if (degrees := self.held_out.get("normal_free_deg")) is not None:
            figures["held-out presses"] = f"normals off by {degrees:.2g} degrees"
        if self.settings.starter is not None:
            figures["starter"] = f"made on other units, slopes off by {100 * self.unit_spread:.0f} %"
        return {**figures, "created": self.created_utc[:10]}

    @cached_property
    def digest(self) -> str:
        """Identity of the content: a digest of arrays and settings. The serial, the gel and loads may come later."""
        arrays, meta = self.contents()
        meta.pop("force", None)
        return digest_of(arrays, {**meta, "serial": None, "gel_id": None})

    @property
    def unit_spread(self) -> float:
        """For a starter, the relative standard deviation of slopes between units; 0 for a calibration of this unit."""
        return 0.0 if self.settings.starter is None else float(self.settings.starter["spread"])

    @property
    def carried(self) -> float:
        """Share of the color model that comes from other units: 1 for a starter, less with presses of this unit, or 0."""
        if self.settings.starter is None and self.settings.start is None:
            return 0.0
        own = self.settings.presses if self.settings.starter is None else 0
        return 1 / (1 + (own or 0) / 2)  # two presses halve it

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings that belong to every result: that the calibration is a starter, and doubts about its background."""
        found = tuple(
            Finding(str(name), str(said), float(figure))
            for name, said, figure in self.settings.findings or ()
        )
        if self.settings.starter is None:
            return found
        message = (
            f"This is a starter, made on other units of a {self.sensor_name}. Slopes and depth may be off by "
            f"{100 * self.unit_spread:.0f} % (one standard deviation). Calibrate with five presses of a ball or more."
        )
        return (Finding("starter", message, self.unit_spread), *found)

    @property
    def most_pixels(self) -> float:
        """Pixels of a picture that can be meant for this sensor; a file that states more is refused before decoding."""
        height, width = self.view.frame_shape or self.image_shape
        # The refusal of a whole camera frame says more than that of its size.
        return min(MAX_PIXELS, max(4 * height * width, 25e6))

    @property
    def known_mm_per_px(self) -> float:
        """The width of a pixel, mm, for callers that need millimeters.

        Raises
        ------
        CalibrationError
            The scale is unknown, because the calibration was imported without one.
        """
        if self.mm_per_px is None:
            raise CalibrationError(
                f"The scale of this calibration ({self.sensor_name}) is unknown. Import it again with the width of a "
                "pixel on the gel: gelform import ... --mm-per-px F."
            )
        return self.mm_per_px

    @cached_property
    def background_digest(self) -> str:
        """SHA-256 of the background's pixels; shows whether a background is the calibration's own."""
        return background_digest(self.background)

    def color_from_gradients(self, gradients: Array) -> Map:
        """Forward response: the expected color change (H, W, 3) of gradients (H, W, 2), for gel at depth 0.

        Raises
        ------
        CalibrationError
            The calibration was imported from a package that has no forward response.
        """
        if self.forward is None:
            raise CalibrationError(
                f"This calibration ({self.sensor_name}, color model {self.color_model.name}) was imported without a "
                "forward response: what color a slope gives is not known. Calibrate on presses of a ball."
            )
        height, width = self.image_shape
        slopes = check_gradients(gradients, shape=(height, width), dtype=np.float64)
        if slopes.ndim != 3:
            raise ValueError(f"Expected gradients of shape ({height}, {width}, 2), got {slopes.shape}.")
        y, x = (axis.ravel() for axis in np.mgrid[:height, :width])
        change = self.forward.color_from_gradients(slopes.reshape(-1, 2), x, y)
        return change.reshape(height, width, 3).astype(np.float32)

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write one .npz without pickles, first under a temporary name.

        Raises
        ------
        CalibrationError
            The file exists and `overwrite` is False, or it cannot be written.
        """
        arrays, meta = self.contents()
        write_npz(
            path, arrays, meta, kind=KIND, version=FORMAT_VERSION, error=CalibrationError, overwrite=overwrite
        )

    def describe(self) -> dict[str, Any]:
        """Settings and figures without the arrays, as values that JSON can hold."""
        return {**self.contents()[1], "digest": self.digest}

    def contents(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """Arrays and settings, in the form of a file."""
        model_arrays, model_settings = self.color_model.to_arrays()
        forward_arrays, forward_settings = ({}, None) if self.forward is None else self.forward.to_arrays()
        if forward_settings is not None:
            del forward_settings["shape"]  # image_shape
        arrays: dict[str, Array] = {
            "background": self.background,
            "background_noise": self.background_noise,
            **{f"forward_{name}": array for name, array in forward_arrays.items()},
            **{f"model_{name}": array for name, array in model_arrays.items()},
        }
        meta: dict[str, Any] = {
            **{name: getattr(self, name) for name in _STORED_AS_THEY_ARE},
            "view": self.view.to_dict(),
            "image_shape": list(self.image_shape),
            "change": asdict(self.change),
            "color_model": self.color_model.name,
            "model_settings": model_settings,
            "forward_settings": forward_settings,
            "slope_sigma": self.slope_sigma and asdict(self.slope_sigma),
            "background_digest": self.background_digest,
            "training_digests": list(self.training_digests),
            "settings": dict(self.settings),
        }
        if self.force is not None:
            meta["force"] = self.force.to_dict()
        return arrays, meta


def load_calibration(path: str | PathLike[str]) -> Calibration:
    """Read a calibration.

    Raises
    ------
    CalibrationError
        The file is missing, truncated, altered, not a calibration, or of a newer format: the message says which.
    """
    version, most = FORMAT_VERSION, 512 * MIB
    arrays, meta = read_npz(path, kind=KIND, newest_version=version, max_bytes=most, error=CalibrationError)
    with damaged(path, "a calibration", "Restore a copy or calibrate again.", CalibrationError):
        return calibration_from_contents(arrays, meta)


def is_calibration(path: str | PathLike[str]) -> bool:
    """Whether a file says that it is a calibration; nothing else of it is read."""
    return kind_of_npz(path) == KIND


def _check_contents(arrays: dict[str, Array], meta: dict[str, Any]) -> None:
    """Refuse settings and arrays of the wrong kind; models and records check their own."""
    for names, kinds in _KINDS:
        for name in names:
            if not isinstance(meta[name], kinds):
                raise TypeError(f"Expected {name} of another type, got {type(meta[name]).__name__}.")
    settings = meta["settings"]
    if meta["mm_per_px"] is not None:
        check_mm_per_px(check_positive(meta["mm_per_px"], "mm_per_px"))
    if meta["mm_per_px_sigma"] is not None:
        check_within(meta["mm_per_px_sigma"], "mm_per_px_sigma", 0, 1e3)
    check_within(meta["untouched_change"], "untouched_change", 0, 1e3)
    if "starter" in settings:
        check_within(settings["starter"]["spread"], "spread", 0, 1)
    if "place_error" in settings:
        check_within(settings["place_error"], "place_error", 0, 1)
    if "gel_thickness_mm" in settings:
        check_gel_thickness(settings["gel_thickness_mm"])
    shape = tuple(meta["image_shape"])
    if len(shape) != 2 or not all(type(size) is int and size > 0 for size in shape):
        raise ValueError(f"Expected image_shape as two whole numbers, got {meta['image_shape']}.")
    check_image(arrays["background"], shape=shape, name="background")
    if check_values(arrays["background_noise"], "background_noise", (3,)).ndim != 1:
        raise ValueError("Expected background_noise of shape (3,).")


_STORED_AS_THEY_ARE = (
    *("sensor_name", "serial", "gel_id", "mm_per_px", "mm_per_px_sigma", "untouched_change", "held_out"),
    *("library_version", "created_utc"),
)
_KINDS: tuple[tuple[tuple[str, ...], Any], ...] = (
    (("sensor_name", "color_model", "library_version", "created_utc"), str),
    (("serial", "gel_id"), (str, type(None))),
    (("view", "change", "model_settings", "held_out", "settings"), dict),
    (("image_shape", "training_digests"), list),
    (("slope_sigma", "forward_settings"), (dict, type(None))),
)


def as_calibration(calibration: Calibration | str | PathLike[str]) -> Calibration:
    """Return a calibration unchanged, or read it from a path; TypeError for anything else."""
    if isinstance(calibration, (str, PathLike)):
        return load_calibration(calibration)
    if not isinstance(calibration, Calibration):
        raise TypeError(f"Expected a Calibration or the path of one, got {type(calibration).__name__}.")
    return calibration


def calibration_from_contents(arrays: dict[str, Array], meta: dict[str, Any]) -> Calibration:
    """Make a calibration from `Calibration.contents`.

    KeyError, TypeError or ValueError: the contents do not fit together.
    """

    def parts(prefix: str) -> dict[str, Array]:
        return {name.removeprefix(prefix): one for name, one in arrays.items() if name.startswith(prefix)}

    _check_contents(arrays, meta)
    height, width = meta["image_shape"]
    models = {**COLOR_MODELS, **IMPORTED_MODELS}
    kind = models[check_choice(meta["color_model"], models, "a color model")]
    forward, slope_sigma = meta["forward_settings"], meta["slope_sigma"]
    if forward is not None:
        forward = ForwardResponse.from_arrays(parts("forward_"), {**forward, "shape": [height, width]})
    return Calibration(
        **{name: meta[name] for name in _STORED_AS_THEY_ARE},
        view=View.from_dict(meta["view"]),
        image_shape=(height, width),
        background=arrays["background"],
        background_noise=arrays["background_noise"],
        change=ChangeSettings(**meta["change"]),
        color_model=kind.from_arrays(parts("model_"), meta["model_settings"]),
        forward=forward,
        slope_sigma=None if slope_sigma is None else SlopeSigma.from_dict(slope_sigma),
        training_digests=tuple(meta["training_digests"]),
        settings=CalibrationSettings.from_dict(meta["settings"]),
        force=ForceModel.from_dict(meta["force"]) if "force" in meta else None,
    )
