"""Color changes of presses, computed once, in which circles are found, also by radial templates.

Find the contact circle of a ball press by radial templates, where the color change is not odd about its center.

In a disc of 1.5 radii about each place, the color change of each channel is fitted by least squares with

    k + a_x p cos + a_y p sin + b p^2 + c q,        q = 1 in the contact, 0 outside,  p = q distance / radius

p is the slope of a ball. The evidence for a ball at that place is `n^0.5 log((E0 + 3 n) / (E1 + 3 n))`: E0 is the energy
about the mean, E1 what the templates leave over, both over the noise, n the number of pixels of the disc in the frame. The
largest evidence over places and radii is the circle. Noise is also what most frames of the set show at a place outside of
their own circles: rims, specks, clipped light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2

from gelform.calibration.circles.find import (
    AGREES,
    MIN_EVIDENCE,
    ContactCircle,
    PreparedPress,
    about_median,
    find_contact,
    magnitude,
    marked_contact,
    parabola_offset,
    scale_of,
)
from gelform.calibration.presses.press_set import Presses
from gelform.errors import CalibrationError
from gelform.foundations.filters import CHANGE_OFFSET
from gelform.foundations.findings import Progress, no_progress
from gelform.image.agreement import check_background_of_frames
from gelform.image.background import ChangeSettings, PreparedBackground
from gelform.image.light import FrameLight
from gelform.image.markers import MarkerFinder
from gelform.slopes.color_models import COLOR_MODELS, PLAIN_MODEL

Circle = tuple[float, float, float]

# The values below are from the study of 58 presses on five home-made sensors, whose circles people marked.
ROWS = 80  # px, shorter side of the picture that is searched
RADII = np.geomspace(0.028, 0.36, 12) * ROWS  # px of that picture
WINDOW = 1.5  # radii of the disc
EDGE, SOFT = 0.95, 0.08  # radii; the middle and the width of a contact's rim
DARK = 30.0  # gray levels; a channel darker than this counts less
FINE, SPANS = (
    12.0,
    ((0.5, 1.2), (0.85, 1.18)),
)  # px of the radius, and factors of it, where a circle is refined
LEAST_NOISE = 0.01  # of the color change, per pixel
COVERED = 1.2  # radii around a circle that do not count as the noise of a place
COMMON, SHARE = 2.0, 0.7  # weight of what this share of the frames stay below at a place
PASSES = 3  # of circles and noise
SIZE_SIGMA = 0.5  # standard deviation of the logarithm of radii in a set


def find_by_templates(
    presses: Sequence[PreparedPress], known: Sequence[Circle | None]
) -> dict[int, tuple[Circle, float]]:
    """The circle of each press of a set whose circle is not known, and the evidence for a ball there, by its index."""
    sought = [k for k, one in enumerate(known) if one is None]
    if not sought:
        return {}
    changes = [_balanced(press) for press in presses]
    factor = ROWS / min(changes[0].shape[:2])
    pictures = np.stack([_resized(change, factor) for change in changes])
    across = pictures.shape[2] / changes[0].shape[1], pictures.shape[1] / changes[0].shape[0]
    circles = [None if one is None else _scaled(one, *across, factor) for one in known]
    evidence = [0.0] * len(presses)
    for _ in range(PASSES):
        noise = _noise(pictures, circles)
        maps = {k: np.stack([_evidence(pictures[k], noise[k], r, 0.5) for r in RADII]) for k in sought}
        radii = [one[2] for one in circles if one is not None and len(presses) >= 3]
        if radii:
            prior = np.exp(-0.5 * (np.log(RADII / np.median(radii)) / SIZE_SIGMA) ** 2)
            maps = {k: one * prior[:, None, None] for k, one in maps.items()}
        for k, one in maps.items():
            circles[k], evidence[k] = _peak(one, RADII)
    found = {}
    for k in sought:
        coarse = _scaled(circles[k] or (0.0, 0.0, 0.0), 1 / across[0], 1 / across[1], 1 / factor)
        found[k] = _refined(changes[k], noise[k], coarse), evidence[k]
    return found


def _balanced(press: PreparedPress) -> NDArray[np.float32]:
    """The color change about its median, as if dark channels had `DARK` gray levels in their divisor."""
    change = press.color_change
    if press.background is not None:
        change = change * ((press.background + CHANGE_OFFSET) / (press.background + DARK)).astype(np.float32)
    return about_median(change)


def _noise(pictures: NDArray[np.float32], circles: Sequence[Circle | None]) -> NDArray[np.float32]:
    """Noise (N, H, W, 3) of each pixel: the frame's own, and what changes there in most frames of another place."""
    size = np.abs(pictures)
    own = np.maximum(1.4826 * np.median(size, axis=(1, 2)), LEAST_NOISE)[:, None, None]
    if len(size) < 3 or any(one is None for one in circles):
        return np.broadcast_to(own, size.shape).astype(np.float32)
    rows, cols = np.mgrid[: size.shape[1], : size.shape[2]]
    for one, circle in zip(size, circles):
        assert circle is not None
        one[np.hypot(cols - circle[0], rows - circle[1]) < COVERED * circle[2]] = np.nan
    seen = np.isfinite(size[..., 0]).any(axis=0)
    common = np.zeros(size.shape[1:], np.float32)
    common[seen] = np.nanquantile(size[:, seen], SHARE, axis=0)
    common = 1.4826 * cv2.GaussianBlur(common, (0, 0), 1.0)
    return np.sqrt(own**2 + (COMMON * np.clip(common - own, 0, None)) ** 2)


@lru_cache(maxsize=64)
def _prepared(shape: tuple[int, int], radius: float) -> tuple[Any, ...]:
    """Templates' spectra, the padding, and at each place the inverse of their products and the number of pixels."""
    reach = int(np.ceil(WINDOW * radius))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1] / radius
    rho = np.hypot(x, y)
    disc = (rho <= WINDOW).astype(float)
    contact = disc / (1 + np.exp(np.clip((rho - EDGE) / SOFT, -30, 30)))
    templates = np.stack([disc, contact * x, contact * y, (contact * rho) ** 2, contact])
    size = [next_fast_len(n + 2 * reach, True) for n in shape]
    frame = np.zeros(size)
    frame[reach : reach + shape[0], reach : reach + shape[1]] = 1
    products = templates[:, None] * templates
    sums = _correlated(np.conj(rfft2(products, s=size)), rfft2(frame), size, shape)
    gram = np.moveaxis(sums, (0, 1), (2, 3)) + 1e-3 * np.eye(len(templates))
    return np.conj(rfft2(templates, s=size)), reach, size, np.linalg.inv(gram), gram[..., 0, 0]


def _correlated(spectra: Any, other: Any, size: Any, shape: tuple[int, int]) -> NDArray[Any]:
    return np.asarray(irfft2(spectra * other, s=size)[..., : shape[0], : shape[1]])


def _evidence(
    picture: NDArray[np.float32], noise: NDArray[np.float32], radius: float, power: float
) -> NDArray[np.float64]:
    """Evidence (H, W) for a ball of a visible radius at each place, in pixels of the picture."""
    shape, channels = (picture.shape[0], picture.shape[1]), picture.shape[2]
    spectra, reach, size, inverse, pixels = _prepared(shape, float(radius))
    over_noise = np.zeros((channels, *size))
    over_noise[:, reach : reach + shape[0], reach : reach + shape[1]] = np.moveaxis(picture / noise, -1, 0)
    sums = _correlated(spectra[:, None], rfft2(over_noise), size, shape)  # (templates, channels, H, W)
    square = _correlated(spectra[0], rfft2(np.square(over_noise).sum(axis=0)), size, shape)
    sums = np.moveaxis(sums, (0, 1), (2, 3))
    mean = np.square(sums[..., 0, :]).sum(axis=-1) / pixels
    explained = (sums * (inverse @ sums)).sum(axis=(-1, -2)) - mean
    total = np.clip(square - mean, 0, None)
    left = np.clip(total - np.clip(explained, 0, None), 0, None)
    unit = channels * pixels
    return np.asarray(pixels**power * np.log((total + unit) / (left + unit)))


def _peak(
    maps: NDArray[np.float64], radii: NDArray[np.float64], near: NDArray[np.bool_] | None = None
) -> tuple[Circle, float]:
    """The circle of the largest value of maps (radii, H, W), between the samples, and that value."""
    looked = maps if near is None else np.where(near, maps, -1)
    i, y, x = (int(k) for k in np.unravel_index(int(looked.argmax()), maps.shape))
    radius = radii[i] * (radii[1] / radii[0]) ** parabola_offset(maps[:, y, x], i)
    at = x + parabola_offset(maps[i, y], x), y + parabola_offset(maps[i, :, x], y)
    return (*at, float(radius)), float(maps[i, y, x])


def _refined(change: NDArray[np.float32], noise: NDArray[np.float32], circle: Circle) -> Circle:
    """The circle found again in a part of the image where its radius is 12 px, twice."""
    noise = cv2.resize(noise, change.shape[1::-1])
    x, y, radius = circle
    for low, high in SPANS:
        factor, reach = FINE / radius, 2.2 * radius
        left, top = int(max(0, x - reach)), int(max(0, y - reach))
        part = slice(top, int(y + reach) + 1), slice(left, int(x + reach) + 1)
        picture, there = _resized(change[part], factor), _resized(noise[part], factor)
        across = picture.shape[1] / change[part].shape[1], picture.shape[0] / change[part].shape[0]
        at = _scaled((x - left, y - top, radius), *across, factor)
        rows, cols = np.mgrid[: picture.shape[0], : picture.shape[1]]
        near = np.hypot(cols - at[0], rows - at[1]) < 0.5 * FINE
        radii = FINE * np.geomspace(low, high, 7)
        best, _ = _peak(np.stack([_evidence(picture, there, r, 0.0) for r in radii]), radii, near)
        x, y, radius = _scaled(best, 1 / across[0], 1 / across[1], 1 / factor)
        x, y = x + left, y + top
    return x, y, radius


def _scaled(circle: Circle, across: float, down: float, factor: float) -> Circle:
    """A circle in a picture that is resized by a factor, whose pixels have their centers at integers."""
    return (circle[0] + 0.5) * across - 0.5, (circle[1] + 0.5) * down - 0.5, circle[2] * factor


def _resized(image: NDArray[np.float32], factor: float) -> NDArray[np.float32]:
    kind = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, None, fx=factor, fy=factor, interpolation=kind))


BLUR_PX = 1.25  # px at 240 rows; it reduces a camera's noise, not the gel's edges
USUAL_OFFSET = COLOR_MODELS[PLAIN_MODEL].change_offset
UNTOUCHED_PERCENTILE = 99.0  # percentile of the size of the color change
UNTOUCHED_DISTANCE = 3  # contact radii
USUAL_UNTOUCHED_CHANGE = 0.03  # if no press leaves room for the measurement


class ColorChanges:
    """Color changes of images from one background image (H, W, 3), 0-255; markers are bridged."""

    def __init__(self, background: NDArray[np.float32], settings: ChangeSettings) -> None:
        self._rest = PreparedBackground(background, settings)
        self._finder = MarkerFinder(background)

    def __call__(self, image: NDArray[Any]) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
        """The color change (H, W, 3) of an image, and the pixels off markers; None if all are.

        Raises
        ------
        CalibrationError
            The background is not of this image.
        """
        light, _ = self._rest.compare(image)
        return change_without_markers(image, self._rest, light, self._finder)


def change_settings(presses: Presses, offset: float = USUAL_OFFSET) -> ChangeSettings:
    """Division by the background, blurred by 1.25 px at 240 rows, after removing known response curve and crosstalk."""
    blur_px = BLUR_PX * scale_of(presses.image_shape)
    return ChangeSettings("divide", offset, blur_px, presses.geometry.matrix, presses.response)


def prepare(
    presses: Presses, offset: float = USUAL_OFFSET, *, progress: Progress = no_progress
) -> list[PreparedPress]:
    """The presses with their color changes, each checked against the background, to which `offset` gray levels are added.

    A press that is of another light is refused, with the reason, and has no color change.

    Raises
    ------
    CalibrationError
        The background does not belong to half of the presses or more, of which one is named, or not to all together.
    """
    changes = ColorChanges(presses.background, change_settings(presses, offset))
    prepared = []
    for done, press in enumerate(presses.presses):
        refused = None
        try:
            change, usable = changes(press.image)
        except CalibrationError as problem:
            change, usable, refused = np.zeros((*presses.image_shape, 3), np.float32), None, str(problem)
        size = magnitude(about_median(change))
        radius_px = press.ball_diameter_mm / 2 / presses.mm_per_px
        mark = press.label if press.center_px is None else (*press.center_px, None)
        rest = presses.background
        prepared.append(
            PreparedPress(press.name, change, size, radius_px, usable, rest, mark=mark, refused=refused)
        )
        progress(done + 1, len(presses.presses), "preparing")
    others = [(one.name, one.refused) for one in prepared if one.refused is not None]
    if 2 * len(others) >= len(prepared):
        name, reason = others[0]
        raise CalibrationError(
            f"{len(others)} of {len(prepared)} presses do not fit the background. {name}: {reason}"
        )
    kept = [press.image for press, one in zip(presses.presses, prepared) if one.refused is None]
    check_background_of_frames(kept, presses.background)
    return prepared


def prepared_with(presses: Presses, prepared: list[PreparedPress], offset: float) -> list[PreparedPress]:
    """The presses, which are `prepared` with the usual offset, with the one that a color model needs.

    Pixels with background 0 cannot be divided with the offset 0; they are not usable then.
    """
    if offset == USUAL_OFFSET:
        return prepared
    divides = np.asarray((presses.background > 0).all(axis=-1), dtype=bool)
    own = []
    for press in prepare(presses, offset):
        usable = press.usable
        if offset == 0 and not divides.all():
            usable = divides if usable is None else usable & divides
        own.append(replace(press, usable=usable, contact_radius_ratio=prepared[0].contact_radius_ratio))
    return own


def untouched_change(presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle]) -> float:
    """Largest color change of pixels at rest, beyond three contact radii."""
    sizes = []
    for press, contact in zip(presses, contacts):
        height, width = press.size.shape
        rows, cols = np.ogrid[:height, :width]
        reach = UNTOUCHED_DISTANCE * contact.radius_px
        far = (cols - contact.x_px) ** 2 + (rows - contact.y_px) ** 2 > reach**2
        if far.any():
            sizes.append(float(np.percentile(press.size[far], UNTOUCHED_PERCENTILE)))
    return float(np.median(sizes)) if sizes else USUAL_UNTOUCHED_CHANGE


def find_contacts(prepared: list[PreparedPress], *, progress: Progress = no_progress) -> list[ContactCircle]:
    """The contact circle of each image: where its color change is odd, else as marked, else by templates of a ball."""
    found = []
    for done, press in enumerate(prepared):
        contact = find_contact(press.color_change)
        if press.mark is not None:
            contact = marked_contact(contact, press.size, *press.mark)
        found.append(contact)
        progress(done + 1, len(prepared), "finding contact circles")
    known = [
        None
        if contact.is_weak and press.refused is None and (press.mark is None or press.mark[2] is None)
        else contact.circle_px
        for press, contact in zip(prepared, found)
    ]
    for k, (circle, evidence) in find_by_templates(prepared, known).items():
        x, y, radius = circle
        apart = np.hypot(x - found[k].x_px, y - found[k].y_px)
        if found[k].marked and apart < AGREES * radius:
            found[k] = replace(found[k], radius_px=radius)  # a stage knows the center alone
        elif evidence >= MIN_EVIDENCE and not found[k].marked:
            found[k] = replace(found[k], x_px=x, y_px=y, radius_px=radius, evidence=evidence)
    return found


def change_without_markers(
    image: NDArray[Any], rest: PreparedBackground, light: FrameLight | None, finder: MarkerFinder
) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
    """The color change (H, W, 3) of an image, smooth across markers, and the pixels on no marker of either image.

    The second is None on a gel without markers. `light` is the one from `rest.compare(image)`, to be compensated, or
    None.
    """
    if not len(finder.untouched):
        return rest.change(image, light), None
    hidden = finder.untouched.mask | finder(image).mask
    return rest.change(rest.bridged(image, hidden), light), ~hidden
