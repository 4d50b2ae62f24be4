"""Starter: a calibration of other units of a make, which today's background image turns into one of this unit.

Units share the positions of their lamps around the gel, and therefore the color of each slope, to some per cent. They
do not share the background image, which takes a second to photograph. So a starter holds the color models, the smooth
light of the make and the spread between units. With a unit's background it becomes a calibration that is marked as such.

The light of a make on gel at rest is thirty numbers: a smooth surface that is fitted to the logarithm of each channel of a
background image. Units differ in the brightness of each channel, in dust and in scratches; the pattern of colors over the
gel is the same. No pixel of an image can be recovered from it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from os import PathLike
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from gelform.arrays import MIB, Array, Map, Numbers
from gelform.calibration_file import Calibration, calibration_from_contents
from gelform.errors import CalibrationError, Finding, SensorError
from gelform.foundations.checks import check_image, check_is, check_mm_per_px, check_positive
from gelform.foundations.files import damaged, read_npz, write_npz
from gelform.image.agreement import READINGS, USUAL_ORDERS, touch_in
from gelform.image.background import noise_from_image, surround_finding
from gelform.image.markers import MarkerFollower
from gelform.image.view import View, image_from_frame
from gelform.sensors.profiles import PROFILES, SENSORS, check_gel_width, make_of, view_from_camera
from gelform.slopes.color_models.seam import StartableModel, node_positions

DEGREE = 3  # degree of the polynomial in x and y
BLOCKS = 16  # blocks along the longer side; the surface is fitted to their means
OFFSET = 1.0  # gray levels, so that black has a logarithm
# Correlation of the patterns of color: units of one make 0.94-0.99, with a touch 0.80 or more, other makes under 0.5.
LEAST_ALIKE, SURELY_ALIKE = 0.7, 0.9
# The pattern of a mirrored, turned or BGR image correlates better by at least this when it is read so. Left and right of a
# Mini differ by less: 0.98 and 0.96.
CLEARLY_ALIKE = 0.1


def light_from_background(background: Array) -> Numbers:
    """The light of a background image (H, W, 3), 0-255.

    It is (10, 3) coefficients of each channel's logarithm, polynomials of the third degree in x and y, fitted to about
    16 x 12 blocks.
    """
    height, width = background.shape[:2]
    step = max(height, width) / BLOCKS
    size = (max(4, round(width / step)), max(4, round(height / step)))
    blocks = cv2.resize(np.asarray(background, dtype=np.float32), size, interpolation=cv2.INTER_AREA)
    target = np.log(blocks.astype(np.float64) + OFFSET).reshape(-1, 3)
    x, y = ((np.arange(n) + 0.5) / n for n in size)
    design = _terms(*np.meshgrid(x, y))
    return np.asarray(np.linalg.lstsq(design, target, rcond=None)[0])


def levels_from_light(light: Numbers, x: Array, y: Array) -> Map:
    """Gray levels (..., 3) of a light at positions 0-1 across the width and down the height, of equal shapes (...)."""
    levels = np.exp(_terms(x, y) @ light) - OFFSET
    return np.clip(levels, 0, 255).astype(np.float32).reshape(*np.shape(x), 3)


def image_of_light(light: Numbers, shape: tuple[int, int]) -> Map:
    """The smooth background image (H, W, 3) of a light."""
    return levels_from_light(light, *pixel_places(np.arange(shape[1]), np.arange(shape[0]), shape))


def pixel_places(columns: Array, rows: Array, shape: tuple[int, int]) -> tuple[Numbers, Numbers]:
    """Positions 0-1 of the pixels at crossings of columns and rows of images (H, W); nodes beyond the border lie on it."""
    x, y = (np.clip((np.asarray(along) + 0.5) / n, 0, 1) for along, n in zip((columns, rows), shape[::-1]))
    across, down = np.meshgrid(x, y)
    return across, down


def gain_between(
    light: Numbers,
    usual: Numbers,
    offset: float,
    shape: tuple[int, int],
    wider: float = 1.0,
) -> Numbers:
    """Usual color change over the color change under a light, at the nodes: (rows, columns, 3).

    A color change is divided by the light plus `offset` gray levels; the offset weighs more in a darker unit. The pixels
    under this light are `wider` times as wide on the gel as those under the usual one.
    """
    rows, columns = node_positions(shape)
    places = pixel_places(columns, rows, shape)
    usual_places = (np.clip(0.5 + wider * (along - 0.5), 0, 1) for along in places)
    own, other = (
        np.maximum(levels_from_light(one, *at).astype(np.float64), 1)
        for one, at in ((light, places), (usual, usual_places))
    )
    return (1 + offset / own) / (1 + offset / other)


def check_light(background: Array, light: Numbers, make: str) -> tuple[Finding, ...]:
    """Refuse a background image without the colors of a make of sensor; return findings.

    Brightness and white balance are free: the pattern of colors over the gel is compared, not the pixels.
    CalibrationError: another make, a turned or mirrored image, or BGR. The message has the figure.
    """
    own = light_from_background(background)
    alike = _alike(own, light)
    if alike < SURELY_ALIKE:
        _check_upright(background, light, make, alike)
    surround = surround_finding(background, "crop the frames to {} (left, top, width, height)")
    if alike < LEAST_ALIKE:
        raise CalibrationError(
            f"Expected the background of a {make}: the colors over its gel correlate by {alike:.2f} with those of its make "
            f"(expected {LEAST_ALIKE} or more). Is it another sensor? Name the right one, or calibrate it with presses of a "
            f"ball.{'' if surround is None else f' {surround.message}'}"
        )
    findings = [] if surround is None else [surround]
    if alike < SURELY_ALIKE:
        message = (
            f"The colors over this gel correlate by {alike:.2f} with those of a {make} (usual: {SURELY_ALIKE} or more). It "
            "is another gel. Calibrate with presses of a ball before you trust a figure."
        )
        findings.append(Finding("starter_light", message, alike))
    if len(MarkerFollower(background)):
        message = "The gel has markers, so gelform cannot tell whether something touches it in the background image."
        findings.append(Finding("background_unchecked", message, 1.0))
    elif touch := touch_in(background):
        findings.append(touch.finding())
    return tuple(findings)


def _check_upright(background: Array, light: Numbers, make: str, alike: float) -> None:
    """Raise a CalibrationError if a background image is clearly more like the make's light when it is read otherwise.

    Several readings are named where the light does not tell them apart.
    """
    turned = {
        one: _alike(light_from_background(one.undone(background)), light)
        for one in READINGS
        if not one.transposed and one.order in USUAL_ORDERS
    }
    best = max(turned.values())
    if best <= max(alike + CLEARLY_ALIKE, LEAST_ALIKE):
        return
    likely = sorted(
        (one for one in turned if turned[one] > best - CLEARLY_ALIKE), key=turned.__getitem__, reverse=True
    )
    raise CalibrationError(
        f"The background is {', or '.join(one.named for one in likely)}: so its colors fit a {make} (correlation {best:.2f} "
        f"against {alike:.2f}). Undo it where images are read: {', or '.join(one.remedy for one in likely)}."
    )


def _terms(x: Array, y: Array) -> Numbers:
    """Legendre polynomials (N, 10) of positions 0-1, up to the third total degree."""
    across, down = (np.polynomial.legendre.legvander(2 * np.ravel(a) - 1, DEGREE) for a in (x, y))
    pairs = [(i, j) for j in range(DEGREE + 1) for i in range(DEGREE + 1 - j)]
    return np.stack([across[:, i] * down[:, j] for i, j in pairs], axis=1)


def _alike(one: Numbers, other: Numbers) -> float:
    """Correlation of the patterns of color of two lights: each channel relative to the channels' mean, over the gel."""
    x, y = np.meshgrid(*((np.arange(BLOCKS) + 0.5) / BLOCKS,) * 2)
    patterns = []
    for light in (one, other):
        surface = _terms(x, y)[:, 1:] @ light[1:]
        pattern = surface - surface.mean(axis=1, keepdims=True)
        patterns.append((pattern - pattern.mean(axis=0)).ravel())
    a, b = patterns
    return float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-12))


KIND, FORMAT_VERSION, MAX_BYTES = "gelform starter", 1, 4 * MIB
FOLDER = files("gelform") / "calibration" / "starters"


@dataclass(frozen=True, eq=False)
class Starter:
    """The common properties of the units of one make of sensor."""

    sensor: str  # name, as in `starter_names`
    calibration: Calibration  # of the units that it was made from; its background is rendered from `light`
    light: Numbers  # (10, 3), light on the gel at rest, from `light_from_background`
    spread: float  # relative standard deviation of the slopes of one unit about those of the make
    units: tuple[str, ...]  # description of the units that it was made from
    # variance of a unit's colors about the forward response, over that of the units that it was fitted to
    color_variance: float = 1.0

    @property
    def make(self) -> str:
        """The sensor's name for people."""
        return make_name(self.sensor)

    def view(self, frame_shape: tuple[int, int]) -> View:
        """The view of frames (H, W) of such a sensor's camera; identity if they already have the size of images.

        SensorError: frames have another aspect than the make's.
        """
        profile = PROFILES.get(self.sensor)
        view = View() if profile is None else profile.view(frame_shape)
        wanted = self.calibration.image_shape
        if (view.shape or frame_shape) == wanted or wanted[0] == wanted[1]:
            return view
        camera = SENSORS[self.sensor].camera if self.sensor in SENSORS else None
        turned = None if camera is None else camera.turned(view, frame_shape, wanted)
        if turned is None:
            raise SensorError(
                f"Expected frames of a {self.make} of the aspect of {wanted[0]}x{wanted[1]} px (height x width), "
                f"got {frame_shape[0]}x{frame_shape[1]}. Turn them by 90 degrees, or choose another camera mode."
            )
        return turned

    def for_unit(
        self,
        background: Array,
        *,
        view: View | None = None,
        mm_per_px: float | None = None,
        serial: str | None = None,
        gel_id: str | None = None,
    ) -> Calibration:
        """The calibration of a unit of this make, from its background image (H, W, 3) alone, 0-255, of the starter's size.

        `view` makes images of its frames (identity by default); `mm_per_px` is the make's by default. In addition to their
        noise, its slopes have an error of `spread`; the standard deviations of results include it.

        CalibrationError: the image is of another make (`check_light`). ValueError, TypeError: no RGB image, or another size;
        no `View`; a serial or gel that is no text.
        """
        for name, value, kind in (("view", view, View), ("serial", serial, str), ("gel_id", gel_id, str)):
            if value is not None:
                check_is(value, kind, name)
        made = self.calibration
        image = check_image(background, shape=made.image_shape, name="background").astype(np.float32)
        findings = check_light(image, self.light, self.make)
        pitch = made.known_mm_per_px if mm_per_px is None else float(check_mm_per_px(mm_per_px)[0])
        check_gel_width(made.image_shape, pitch, self.sensor)
        model, forward = self.models_for(light_from_background(image), pitch)
        sigma = made.slope_sigma
        assert sigma is not None
        record = {
            "sensor": self.sensor,
            "spread": self.spread,
            "units": list(self.units),
        }
        return replace(
            made,
            sensor_name=self.make,
            serial=serial,
            gel_id=gel_id,
            view=View() if view is None else view,
            mm_per_px=pitch,
            mm_per_px_sigma=made.mm_per_px_sigma if mm_per_px is None else None,
            background=image,
            background_noise=noise_from_image(image),
            color_model=model,
            forward=forward,
            slope_sigma=replace(sigma, gain_sigma=float(np.hypot(sigma.gain_sigma, self.spread))),
            held_out={},
            settings=replace(
                made.settings,
                starter=record,
                findings=[[one.name, one.message, one.figure] for one in findings] or None,
            ),
        )

    def for_frame(self, background: ArrayLike, **known: Any) -> Calibration:
        """`for_unit` of a background frame as the camera gives it, or an image; see `calibration_from_background`."""
        frame = check_image(background, name="background")
        view = self.view((int(frame.shape[0]), int(frame.shape[1])))
        image = frame if view.is_identity else image_from_frame(frame, view)
        made = self.for_unit(image, view=view, **known)
        if view.is_identity:
            made = replace(made, view=view_from_camera(self.sensor, made.image_shape, made.mm_per_px))
        return made

    def models_for(self, light: Numbers, mm_per_px: float) -> tuple[Any, Any]:
        """Color model and forward response of a unit with another light (10, 3) and scale, for its color changes.

        The lamps stand around the gel, so that places and depths are equal in mm, counted from the middle of the image.
        """
        made = self.calibration
        wider = mm_per_px / made.known_mm_per_px
        gain = gain_between(light, self.light, made.change.offset, made.image_shape, wider)
        assert isinstance(made.color_model, StartableModel)
        assert made.forward is not None
        forward = made.forward.of_other_unit(gain, wider)
        forward = replace(forward, covariance=self.color_variance * forward.covariance)
        return made.color_model.of_other_unit(gain, wider), forward

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write one .npz without the background, in single precision.

        CalibrationError: the file exists and `overwrite` is False, or it cannot be written.
        """
        arrays, meta = self.calibration.contents()
        del arrays["background"]
        arrays = {name: v.astype(np.float32) if name.endswith("nodes") else v for name, v in arrays.items()}
        arrays["light"] = self.light
        own = {name: getattr(self, name) for name in ("sensor", "spread", "color_variance")}
        meta = {"calibration": meta, **own, "units": list(self.units)}
        error = CalibrationError
        write_npz(path, arrays, meta, kind=KIND, version=FORMAT_VERSION, error=error, overwrite=overwrite)


def starter_from_calibration(
    calibration: Calibration,
    sensor: str,
    *,
    spread: float,
    units: tuple[str, ...],
    color_variance: float = 1.0,
) -> Starter:
    """Make a starter from one unit's calibration; its background is replaced by thirty numbers."""
    light = light_from_background(calibration.background)
    smooth = image_of_light(light, calibration.image_shape)
    plain = replace(calibration, background=smooth, view=View(), serial=None, gel_id=None, report=None)
    return Starter(sensor, plain, light, check_positive(spread, "spread"), units, color_variance)


def read_starter(path: str | PathLike[str]) -> Starter:
    """Read a starter's file; CalibrationError: it is missing, damaged, of another kind, or of a newer format."""
    arrays, meta = read_npz(
        path, kind=KIND, newest_version=FORMAT_VERSION, max_bytes=MAX_BYTES, error=CalibrationError
    )
    with damaged(path, "a starter", "Copy it again.", CalibrationError):
        light = np.asarray(arrays.pop("light"), dtype=np.float64)
        height, width = meta["calibration"]["image_shape"]
        arrays = {name: v.astype(np.float64) if name.endswith("nodes") else v for name, v in arrays.items()}
        arrays["background"] = image_of_light(light, (height, width))
        calibration = calibration_from_contents(arrays, meta["calibration"])
        figures = float(meta["spread"]), tuple(meta["units"]), float(meta.get("color_variance", 1))
        return Starter(meta["sensor"], calibration, light, *figures)


@cache
def starter_names() -> tuple[str, ...]:
    """The names of the sensors that have a starter."""
    names = (one.name for one in FOLDER.iterdir())
    return tuple(sorted(name.removesuffix(".npz") for name in names if name.endswith(".npz")))


def make_name(sensor: str) -> str:
    """A sensor's name for people."""
    return PROFILES[sensor].name if sensor in PROFILES else sensor


def load_starter(sensor: str) -> Starter:
    """The starter of a sensor by its name; SensorError: there is none, of those that the message lists."""
    if not isinstance(sensor, str):
        raise TypeError(
            f"Expected sensor as a name, such as {starter_names()[0]!r}, got a {type(sensor).__name__}. In "
            "calibration_from_background, the background comes first."
        )
    if sensor not in starter_names():
        raise SensorError(
            f"Expected a sensor with a starter, {', '.join(starter_names())}, got {sensor!r}. "
            "Another one is calibrated with presses of a ball: gelform calibrate."
        )
    return _packaged(str(FOLDER / f"{sensor}.npz"))


_packaged = cache(read_starter)


def starter_of_make(make: str | None) -> Starter | None:
    """The starter of a real make; None if there is none."""
    return load_starter(make) if make in PROFILES and make in starter_names() else None


def starter_for(make: str | None, image_shape: tuple[int, int]) -> Starter | None:
    """The starter of a real make, for images (H, W); None if there is none."""
    starter = starter_of_make(make)
    return starter if starter is not None and starter.calibration.image_shape == tuple(image_shape) else None


def starter_of_source(source: Any) -> str | None:
    """The name of the starter of a source of frames, by its camera's USB id or by its own name; None without one."""
    kind = getattr(getattr(source, "camera", None), "kind", None) or make_of(str(getattr(source, "name", "")))
    return kind if kind in starter_names() else None


def at_rest_again(calibration: Calibration, background: Map) -> Calibration:
    """A starter's calibration from another background image (H, W, 3), with the same view and scale.

    CalibrationError: as `Starter.for_unit`. SensorError: its starter is not in this version.
    """
    assert calibration.settings.starter is not None
    starter = load_starter(calibration.settings.starter["sensor"])
    return starter.for_unit(
        background,
        view=calibration.view,
        mm_per_px=calibration.mm_per_px,
        serial=calibration.serial,
        gel_id=calibration.gel_id,
    )


def calibration_from_background(
    background: ArrayLike,
    sensor: str,
    *,
    mm_per_px: float | None = None,
    serial: str | None = None,
    gel_id: str | None = None,
) -> Calibration:
    """A calibration of a known sensor from its background image alone, based on other units of its make.

    Every result of it has a finding about the starter, and larger standard deviations. Presses of a ball improve it:
    `calibrate(presses, start=...)` begins with it.

    Parameters
    ----------
    background : (H, W, 3), 0-255, RGB
        A frame of the gel at rest, or an average of several, as the camera gives it; or an image that already has the
        size of the make's images.
    sensor : a name in `starter_names()`, such as "gelsight-mini"
    mm_per_px : by default the make's
    serial, gel_id : of the unit and its gel

    Returns
    -------
    Calibration
        With `settings.starter`: the make, the spread between its units, and the units that it was made from.

    Raises
    ------
    SensorError
        The sensor has no starter, or the frames have another aspect than the make's.
    CalibrationError
        The image is of another make, or dark or saturated in parts.
    ValueError, TypeError
        No RGB image, or of a size that the make does not have.
    """
    return load_starter(sensor).for_frame(background, mm_per_px=mm_per_px, serial=serial, gel_id=gel_id)
