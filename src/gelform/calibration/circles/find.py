"""Presses, prepared once: their color changes, the contact circle that each image shows, and samples of known slopes.

A ball's color change is antisymmetric about its center, because color is nearly odd in the gradient and the
gradient is odd about the center. So the color change convolved with itself is most negative at the center,
and the ring mean of its size falls most steeply at the visible rim.

Where the color change is not odd, radial templates find the circle. In a disc of 1.5 radii about each place, the color
change of each channel is fitted by least squares with

    k + a_x p cos + a_y p sin + b p^2 + c q,        q = 1 in the contact, 0 outside,  p = q distance / radius

p is the slope of a ball. The evidence for a ball at that place is `n^0.5 log((E0 + 3 n) / (E1 + 3 n))`: E0 is the energy
about the mean, E1 what the templates leave over, both over the noise, n the number of pixels of the disc in the frame. The
largest evidence over places and radii is the circle. Noise is also what most frames of the set show at a place outside of
their own circles: rims, specks, clipped light.

Inside the contact edge the gel follows the ball. Near the visible rim it has already left it, so a model trains only
inside the contact edge, which is measured on held-out presses (`circles.locate`).
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import scipy
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import gaussian_filter1d
from scipy.special import expit

from gelform.arrays import Array, Map, Mask, Numbers
from gelform.calibration.presses.press_set import Circle, Presses, check_room
from gelform.errors import CalibrationError, DataError, Progress, no_progress
from gelform.foundations.files import written_file
from gelform.foundations.filters import CHANGE_OFFSET, SIGMA_OF_MEDIAN
from gelform.image.agreement import check_background_of_frames
from gelform.image.background import ChangeSettings, PreparedBackground
from gelform.image.markers import MarkerFinder
from gelform.image.view import scale_of
from gelform.result.metrics import ball_gradients, followed_radius
from gelform.slopes.color_models import COLOR_MODELS, PLAIN_MODEL, ColorModel, Samples

MIN_ANTISYMMETRY = 0.2  # 0-1, for a ball with more than half inside the border
MIN_SIGNAL = 2.0  # change inside over that outside; 1 if nothing is pressed
# Evidence of templates for a ball: 7-27 on home-made gels, up to 14 in frames without a press, 43 or more on other sensors.
MIN_EVIDENCE = 10.0
AGREES = 0.5  # radii; a circle by hand or a stage's center this near to a clear ball is of the same press
BLUR_PX = 1.25  # px at 240 rows; it reduces a camera's noise, not the gel's edges
USUAL_OFFSET = COLOR_MODELS[PLAIN_MODEL].change_offset
USUAL_UNTOUCHED_CHANGE = 0.03  # if no press leaves room for the measurement
TOTAL_SAMPLES = 40_000  # pixels of all presses; twice as many fit no better
TRIAL_SAMPLES = 15_000  # pixels of all presses for a fit that places circles or is tried on held-out presses
PRESS_PIXELS = 1_500  # pixels of a press that a model is compared with; neighbors are copies
LEAST_PIXELS = 30  # of a contact; fewer show no ball
RIM = 0.4  # of the expected radius, either way: where the visible rim is searched for
REACH = 0.6  # of the shorter side: the largest ring about a center
ZONE = 0.95  # fraction of the contact radius that trains
# Fraction of the visible radius: 0.74-0.90 on five simulated sensors, 0.81-0.91 as measured on real ones.
USUAL_EDGE = 0.85
REST_DISTANCE = 2.0  # visible radii, beyond which gel at rest trains

# The values of the templates are from the study of 58 presses on five home-made sensors, whose circles people marked.
ROWS = 80  # px, shorter side of the picture that is searched
RADII = np.geomspace(0.028, 0.36, 12) * ROWS  # px of that picture
FINE = 12.0  # px of the radius, where a circle is refined
COMMON = 2.0  # weight, in the noise of a place, of what 70 % of the frames stay below there


@dataclass(frozen=True)
class ContactCircle:
    """A contact circle."""

    x_px: float  # center, px; may lie outside the frame
    y_px: float
    radius_px: float  # at which the color change falls most steeply: the visible rim
    # 0-1, share of the color change's energy that is odd about the center; a ball cut by the border keeps less
    antisymmetry: float
    signal: float  # color change inside the circle over that outside; about 1 if nothing is pressed
    evidence: float | None = None  # of templates for a ball there, if they found it
    marked: bool = False  # whether its center is a person's or a stage's

    @property
    def is_weak(self) -> bool:
        """Whether other finders are asked: the color change is hardly odd, or hardly larger than around the circle.

        The lowest antisymmetry of 280 good presses on six sensors is 0.36.
        """
        return self.antisymmetry < 0.3 or self.signal < MIN_SIGNAL

    @property
    def circle_px(self) -> Circle:
        """(center x, center y, radius)."""
        return self.x_px, self.y_px, self.radius_px

    def is_whole_in(self, shape: tuple[int, int]) -> bool:
        """Whether it lies inside an image (H, W); a circle that the border cuts is found too far inside."""
        x, y, margin = self.circle_px
        return margin <= x <= shape[1] - 1 - margin and margin <= y <= shape[0] - 1 - margin


@dataclass(frozen=True)
class PreparedPress:
    """One press, ready to be fitted: its color change, the circle found in it, and its ball."""

    name: str
    color_change: Map  # (H, W, 3) float32, blurred
    size: Map  # (H, W) float32, |color change - its median|
    ball_radius_px: float
    found: ContactCircle  # the circle that the image shows by itself
    usable: Mask | None = None  # (H, W) bool, False on markers; None if all pixels are
    background: Map | None = None  # (H, W, 3), the background image of all presses; or None
    # radius of the contact edge over that of the visible circle; the same for all presses
    contact_radius_ratio: float = USUAL_EDGE
    # (x, y, radius) px of the circle by a person; (x, y, None) of a stage's center; or None
    mark: tuple[float, float, float | None] | None = None
    refused: str | None = None  # the reason that the image is not of this background, or None
    depth_px: Map | None = None  # (H, W), as a color model reads it, where forward responses are fitted

    def contact_radius(self, contact: ContactCircle) -> float:
        """Radius, px, up to which the gel follows the ball."""
        return self.contact_radius_ratio * followed_radius(contact.radius_px, self.ball_radius_px)

    def is_deep(self, contact: ContactCircle) -> bool:
        """Whether the visible circle is at least as wide as the ball; then the gel leaves the ball inside of it."""
        return followed_radius(contact.radius_px, self.ball_radius_px) < contact.radius_px

    def pixels(self, contact: ContactCircle, zone: float, count: int | None = None) -> tuple[Array, Array]:
        """Rows and columns of about `count` pixels inside `zone` of the contact's radius, on a regular lattice."""
        radius = zone * self.contact_radius(contact)
        height, width = self.size.shape
        top, bottom = (int(np.clip(contact.y_px + side * (radius + 1), 0, height)) for side in (-1, 1))
        left, right = (int(np.clip(contact.x_px + side * (radius + 1), 0, width)) for side in (-1, 1))
        rows, cols = np.ogrid[top : min(bottom + 1, height), left : min(right + 1, width)]
        inside = (cols - contact.x_px) ** 2 + (rows - contact.y_px) ** 2 < radius**2
        if self.usable is not None:
            inside &= self.usable[rows, cols]
        stride = 1 if count is None else int(max(1, round(np.count_nonzero(inside) / max(count, 1))))
        if stride > 1:
            inside &= (cols + 3 * rows) % stride == 0
        found_rows, found_cols = np.nonzero(inside)
        return found_rows + top, found_cols + left

    def ball_gradients(self, contact: ContactCircle, rows: Array, cols: Array) -> Numbers:
        """The ball's slopes at pixels."""
        return ball_gradients(cols, rows, (contact.x_px, contact.y_px), self.ball_radius_px)

    def gradients(self, model: ColorModel, rows: Array, cols: Array) -> Numbers:
        """The slopes that a color model reads there."""
        return model.gradients_at(self.color_change[rows, cols], cols, rows)

    def samples(self, rows: Array, cols: Array, gradients: Numbers, weight: float) -> Samples:
        """Pixels of known gradients (N, 2), all of one weight, with their depths if those are known."""
        depth = None if self.depth_px is None else self.depth_px[rows, cols]
        change, weights = self.color_change[rows, cols], np.full(len(rows), weight)
        return Samples(change, cols, rows, gradients, weights, self.size.shape, self.background, depth)


class ColorChanges:
    """Color changes of images from one background image (H, W, 3), 0-255, smooth across markers."""

    def __init__(self, background: Map, settings: ChangeSettings) -> None:
        self._rest = PreparedBackground(background, settings)
        self._finder = MarkerFinder(background)

    def __call__(self, image: Array) -> tuple[Map, Mask | None]:
        """The color change (H, W, 3) of an image, and the pixels on no marker of either image.

        The second is None on a gel without markers. CalibrationError: the background is not of this image.
        """
        light, _ = self._rest.compare(image)
        if not len(self._finder.untouched):
            return self._rest.change(image, light), None
        hidden = self._finder.untouched.mask | self._finder(image).mask
        return self._rest.change(self._rest.bridged(image, hidden), light), ~hidden


def change_settings(presses: Presses, offset: float = USUAL_OFFSET) -> ChangeSettings:
    """Division by the background, blurred by 1.25 px at 240 rows, after removing known response curve and crosstalk."""
    blur_px = BLUR_PX * scale_of(presses.image_shape)
    return ChangeSettings("divide", offset, blur_px, presses.geometry.matrix, presses.response)


def prepare(presses: Presses, *, progress: Progress = no_progress) -> list[PreparedPress]:
    """The presses with their color changes, each checked against the background, and the circle found in each.

    A press that is of another light is refused, with the reason, and has no color change. CalibrationError: the background
    does not belong to half of the presses or more, of which one is named, or not to all together.
    """
    prepared, changes = [], _color_changes(presses, USUAL_OFFSET, progress)
    for done, (press, (change, usable, refused)) in enumerate(zip(presses.presses, changes)):
        size = magnitude(about_median(change))
        ball_px = press.ball_diameter_mm / 2 / presses.mm_per_px
        mark = press.label if press.center_px is None else (*press.center_px, None)
        found, rest = _kept_contact(change), presses.background
        prepared.append(
            PreparedPress(press.name, change, size, ball_px, found, usable, rest, mark=mark, refused=refused)
        )
        progress(done + 1, len(changes), "finding contact circles")
    return with_contacts(prepared)


def _color_changes(
    presses: Presses, offset: float, progress: Progress = no_progress
) -> list[tuple[Map, Mask | None, str | None]]:
    """The color change of each press with an offset in gray levels, its usable pixels, and the reason that it is refused."""
    changes = ColorChanges(presses.background, change_settings(presses, offset))
    made: list[tuple[Map, Mask | None, str | None]] = []
    for done, press in enumerate(presses.presses):
        try:
            made.append((*changes(press.image), None))
        except CalibrationError as problem:
            made.append((np.zeros((*presses.image_shape, 3), np.float32), None, str(problem)))
        progress(done + 1, len(presses.presses), "preparing")
    others = [(press.name, why) for press, (*_, why) in zip(presses.presses, made) if why is not None]
    if 2 * len(others) >= len(made):
        raise CalibrationError(
            f"{len(others)} of {len(made)} presses do not fit the background. {others[0][0]}: {others[0][1]}"
        )
    kept = [press.image for press, (*_, why) in zip(presses.presses, made) if why is None]
    check_background_of_frames(kept, presses.background)
    return made


def prepared_with(presses: Presses, prepared: list[PreparedPress], offset: float) -> list[PreparedPress]:
    """The presses, which are `prepared` with the usual offset, with the color changes that a color model needs.

    Pixels with background 0 cannot be divided with the offset 0; they are not usable then.
    """
    if offset == USUAL_OFFSET:
        return prepared
    divides = np.asarray((presses.background > 0).all(axis=-1), dtype=bool)
    own = []
    for press, (change, usable, refused) in zip(prepared, _color_changes(presses, offset)):
        if offset == 0 and not divides.all():
            usable = divides if usable is None else usable & divides
        size = magnitude(about_median(change))
        own.append(replace(press, color_change=change, size=size, usable=usable, refused=refused))
    return own


def untouched_change(presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle]) -> float:
    """Largest color change (of 99 % of the pixels) at rest, beyond three contact radii."""
    sizes = []
    for press, contact in zip(presses, contacts):
        far = distances_px(press.size.shape, contact.x_px, contact.y_px) > 3 * contact.radius_px
        if far.any():
            sizes.append(float(np.percentile(press.size[far], 99.0)))
    return float(np.median(sizes)) if sizes else USUAL_UNTOUCHED_CHANGE


def distances_px(shape: tuple[int, ...], x_px: float, y_px: float) -> Array:
    """Distance (H, W) of each pixel of an image (H, W, ...) from a point, px."""
    rows, cols = np.ogrid[: shape[0], : shape[1]]
    return np.asarray(np.hypot(cols - x_px, rows - y_px))


def about_median(color_change: Map) -> Map:
    """A color change (H, W, 3) minus its median over the image."""
    return np.asarray(color_change - np.median(color_change, axis=(0, 1)).astype(np.float32))


def magnitude(change: Map) -> Map:
    """Size (H, W) of a color change."""
    return np.asarray(np.sqrt(np.einsum("...c,...c->...", change, change)))


def with_contacts(prepared: list[PreparedPress]) -> list[PreparedPress]:
    """The presses with their circles: where color changes are odd, as found; else as marked; else by templates of a ball."""
    found = [
        press.found if press.mark is None else marked_contact(press.found, press.size, *press.mark)
        for press in prepared
    ]
    known = [
        None
        if contact.is_weak
        and contact.evidence is None
        and press.refused is None
        and (press.mark is None or press.mark[2] is None)
        else contact.circle_px
        for press, contact in zip(prepared, found)
    ]
    for k, ((x, y, radius), evidence) in find_by_templates(prepared, known).items():
        apart = np.hypot(x - found[k].x_px, y - found[k].y_px)
        if found[k].marked and apart < AGREES * radius:
            found[k] = replace(found[k], radius_px=radius)  # a stage knows the center alone
        elif evidence >= MIN_EVIDENCE and not found[k].marked:
            found[k] = replace(found[k], x_px=x, y_px=y, radius_px=radius, evidence=evidence)
    return [replace(press, found=contact) for press, contact in zip(prepared, found)]


# The folder, and the digest of what finds circles.
_kept_in: ContextVar[tuple[Path, bytes] | None] = ContextVar("kept circles", default=None)
KEPT_S = 30 * 86400  # after which a circle is not looked for again


@contextmanager
def circles_kept(folder: Path | None) -> Iterator[None]:
    """Within it, each circle that an image shows by itself is kept in a folder, and read there if it was found before.

    So work that was interrupted goes on behind them. A file is named by the color change and by the code that finds circles;
    None: nothing is kept. The library does this for no one who does not ask; `gelform calibrate` asks.
    """
    token = _kept_in.set(None if folder is None else (folder, _digest_of_code()))
    if folder is not None:
        for old in folder.glob("*.json"):
            with suppress(OSError):  # another process is as tidy
                if time.time() - old.stat().st_mtime > KEPT_S:
                    old.unlink()
    try:
        yield
    finally:
        _kept_in.reset(token)


def _digest_of_code() -> bytes:
    """Of all files of gelform and the versions of the libraries it computes with: a circle rests on nothing else."""
    code = sha256(f"{np.__version__} {scipy.__version__} {cv2.__version__}".encode())
    root = Path(__file__).parents[2]
    for path in sorted((*root.rglob("*.py"), *root.glob("_native/*"))):
        if path.is_file():
            code.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return code.digest()


def _kept_contact(change: Map) -> ContactCircle:
    """`find_contact`, or what it found before, which is the same to the bit."""
    kept = _kept_in.get()
    if kept is None:
        return find_contact(change)
    folder, code = kept
    content = sha256(code + str(change.shape).encode())
    content.update(np.ascontiguousarray(change).data)
    path = folder / f"{content.hexdigest()}.json"
    # There is none, or what is there is none.
    with suppress(OSError, ValueError, TypeError):
        return ContactCircle(**json.loads(path.read_bytes()))
    found = find_contact(change)
    # A full disk costs the next try its start, not this one its end.
    with suppress(DataError), written_file(path, overwrite=True, flushed=False) as handle:
        handle.write(json.dumps(asdict(found), default=float).encode())
    return found


def find_contact(color_change: Map) -> ContactCircle:
    """Contact circle of one ball press, in a color change (H, W, 3) that is blurred by about 1.25 px at 240 rows.

    The center c maximizes -sum_v d(c + v) . d(c - v), by one zero-padded FFT per channel. DataError: the image is too small
    to hold a contact.
    """
    check_room(color_change.shape)
    change = about_median(color_change)
    height, width = change.shape[:2]
    padded = (next_fast_len(2 * height, True), next_fast_len(2 * width, True))
    spectrum = rfft2(change, s=padded, axes=(0, 1))
    odd = -irfft2(spectrum**2, s=padded, axes=(0, 1)).sum(axis=-1)[: 2 * height - 1, : 2 * width - 1]
    row, col = (int(i) for i in np.unravel_index(int(odd.argmax()), odd.shape))
    y = (row + parabola_offset(odd[:, col], row)) / 2
    x = (col + parabola_offset(odd[row], col)) / 2
    antisymmetry = float(odd[row, col]) / max(float(np.square(change, dtype=np.float64).sum()), 1e-12)
    size = magnitude(change)
    radius = contact_radius(size, x, y)
    return ContactCircle(x, y, radius, antisymmetry, _signal(size, x, y, radius))


def marked_contact(
    found: ContactCircle, size: Map, x_px: float, y_px: float, radius_px: float | None
) -> ContactCircle:
    """The contact about a center that a person or a stage gives, if the found one is weak or agrees; else the found one.

    The radius is measured about that center, near the given one if any.
    """
    apart = np.hypot(found.x_px - x_px, found.y_px - y_px)
    if not found.is_weak and apart > AGREES * (radius_px or found.radius_px):
        return found
    radius = contact_radius(size, x_px, y_px, radius_px)
    signal = _signal(size, x_px, y_px, radius)
    return replace(found, x_px=x_px, y_px=y_px, radius_px=radius, signal=signal, marked=True)


def why_no_contact(contact: ContactCircle) -> str | None:
    """The reason that a found circle is not a ball press, or None."""
    if contact.marked or (contact.evidence is not None and contact.evidence >= MIN_EVIDENCE):
        return None
    if contact.antisymmetry < MIN_ANTISYMMETRY:
        return (
            f"no ball found: too light, cut by the border, or no ball (antisymmetry {contact.antisymmetry:.2f}, expected "
            f"{MIN_ANTISYMMETRY} or more)"
        )
    if contact.signal < MIN_SIGNAL:
        return f"no contact found: the change inside is {contact.signal:.1f} times that outside (expected {MIN_SIGNAL:g})"
    return None


def contact_radius(size: Map, x_px: float, y_px: float, near_px: float | None = None) -> float:
    """Radius of the steepest descent of the ring mean of |change| about a center; near a given one if any."""
    scale, last = scale_of(size.shape), int(REACH * min(size.shape))
    blur = 2 * scale
    low, high = 3 * blur, last - 3 * blur
    if near_px is not None:
        low, high = max(low, (1 - RIM) * near_px), min(high, (1 + RIM) * near_px + blur)
        last = min(last, int(max(low, high) + 4 * blur) + 3)  # as far as the filter reaches
    slope = gaussian_filter1d(ring_mean(size, x_px, y_px, count=last), blur, order=1)
    start, stop = int(low), max(int(low) + 1, int(high))
    peak = start + int(np.argmin(slope[start:stop]))
    return peak + parabola_offset(slope, peak)


def ring_mean(
    values: Map, x_px: float, y_px: float, aspect: float = 1.0, count: int | None = None
) -> Numbers:
    """Mean of a map on rings of 1 px about a center, `count` or out to 0.6 of the shorter side; of a width over height."""
    count = int(REACH * min(values.shape)) if count is None else count
    reach = count * max(aspect, 1 / aspect) ** 0.5 + 1
    top, left = (int(np.clip(at - reach, 0, n)) for at, n in zip((y_px, x_px), values.shape))
    values = values[top : max(0, int(y_px + reach) + 2), left : max(0, int(x_px + reach) + 2)]
    height, width = values.shape
    columns = (np.arange(left, left + width, dtype=np.float32) - np.float32(x_px)) ** 2 / np.float32(aspect)
    rows = (np.arange(top, top + height, dtype=np.float32) - np.float32(y_px)) ** 2 * np.float32(aspect)
    ring = np.minimum(np.sqrt(rows[:, None] + columns) + 0.5, count).astype(np.intp).ravel()
    total = np.bincount(ring, values.ravel(), minlength=count + 1)[:count]
    pixels = np.bincount(ring, minlength=count + 1)[:count]
    return total / np.maximum(pixels, 1)


def _signal(size: Map, x: float, y: float, radius: float) -> float:
    rho = distances_px(size.shape, x, y) / radius
    inside, outside = size[(rho > 0.4) & (rho < 0.9)], size[rho > 1.6]
    if not inside.size or not outside.size:
        return float("inf") if inside.size else 0.0
    return float(inside.mean() / max(float(np.percentile(outside, 80)), 1e-6))


def parabola_offset(values: Array, index: int) -> float:
    """Sub-sample offset of an extremum from its two neighbors, within half a sample."""
    if not 0 < index < len(values) - 1:
        return 0.0
    before, here, after = (float(values[index + i]) for i in (-1, 0, 1))
    curvature = before - 2 * here + after
    return float(np.clip((before - after) / (2 * curvature), -0.5, 0.5)) if curvature else 0.0


def find_by_templates(
    presses: Sequence[PreparedPress], known: Sequence[Circle | None]
) -> dict[int, tuple[Circle, float]]:
    """The circle of each press of a set whose circle is not known, and the evidence for a ball there, by its index."""
    sought = [k for k, one in enumerate(known) if one is None]
    if not sought:
        return {}
    changes = []  # about their median, as if dark channels had 30 gray levels in their divisor
    for press in presses:
        change = press.color_change
        if press.background is not None:
            divisors = (press.background + CHANGE_OFFSET) / (press.background + 30)
            change = change * divisors.astype(np.float32)
        changes.append(about_median(change))
    factor = ROWS / min(changes[0].shape[:2])
    pictures = np.stack([_resized(change, factor) for change in changes])
    across = pictures.shape[2] / changes[0].shape[1], pictures.shape[1] / changes[0].shape[0]
    circles = [None if one is None else _scaled(one, *across, factor) for one in known]
    evidence = [0.0] * len(presses)
    for _ in range(3 if len(presses) >= 3 else 1):  # of circles and noise, which follows from three
        noise = _noise(pictures, circles)
        radii = [one[2] for one in circles if one is not None and len(presses) >= 3]
        for k in sought:
            maps = np.stack([_evidence(pictures[k], noise[k], r, 0.5) for r in RADII])
            if radii:  # the logarithms of radii in a set have a standard deviation of 0.5
                maps *= np.exp(-0.5 * (np.log(RADII / np.median(radii)) / 0.5) ** 2)[:, None, None]
            circles[k], evidence[k] = _peak(maps, RADII)
    found = {}
    for k in sought:
        coarse = _scaled(circles[k] or (0.0, 0.0, 0.0), 1 / across[0], 1 / across[1], 1 / factor)
        found[k] = _refined(changes[k], noise[k], coarse), evidence[k]
    return found


def _noise(pictures: Map, circles: Sequence[Circle | None]) -> Map:
    """Noise (N, H, W, 3) of each pixel: the frame's own, and what changes there in most frames of another place."""
    size = np.abs(pictures)
    of_frames = SIGMA_OF_MEDIAN * np.median(size, axis=(1, 2))
    own = np.maximum(of_frames, 0.01)[:, None, None]  # of the color change
    if len(size) < 3 or any(one is None for one in circles):
        return np.broadcast_to(own, size.shape).astype(np.float32)
    for one, circle in zip(size, circles):
        assert circle is not None
        one[distances_px(one.shape, *circle[:2]) < 1.2 * circle[2]] = np.nan
    # NaN comes last, so that a quantile of the rest is a look-up; np.nanquantile takes hundreds of times as long.
    ordered = np.sort(size, axis=0)
    last = np.isfinite(ordered).sum(axis=0, keepdims=True) - 1
    at = np.maximum(0.7 * last, 0)
    low, high = (np.take_along_axis(ordered, f(at).astype(int), axis=0) for f in (np.floor, np.ceil))
    common = np.nan_to_num(low + (high - low) * (at % 1))[0].astype(np.float32)
    common = SIGMA_OF_MEDIAN * cv2.GaussianBlur(common, (0, 0), 1.0)
    return np.sqrt(own**2 + (COMMON * np.clip(common - own, 0, None)) ** 2)


@lru_cache(maxsize=64)
def _prepared(shape: tuple[int, int], radius: float) -> tuple[Any, ...]:
    """Templates' spectra, the padding, and at each place the inverse of their products and the number of pixels."""
    end = 1.5  # radii of the disc
    reach = int(np.ceil(end * radius))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1] / radius
    rho = np.hypot(x, y)
    disc = (rho <= end).astype(float)
    contact = disc * expit((0.95 - rho) / 0.08)  # a soft rim, 0.08 radii wide
    templates = np.stack([disc, contact * x, contact * y, (contact * rho) ** 2, contact])
    size = [next_fast_len(n + 2 * reach, True) for n in shape]
    frame = np.zeros(size)
    frame[reach : reach + shape[0], reach : reach + shape[1]] = 1
    products = templates[:, None] * templates
    sums = _correlated(np.conj(rfft2(products, s=size)), rfft2(frame), size, shape)
    gram = np.moveaxis(sums, (0, 1), (2, 3)) + 1e-3 * np.eye(len(templates))
    return np.conj(rfft2(templates, s=size)), reach, size, np.linalg.inv(gram), gram[..., 0, 0]


def _correlated(spectra: Any, other: Any, size: Any, shape: tuple[int, int]) -> Array:
    return np.asarray(irfft2(spectra * other, s=size)[..., : shape[0], : shape[1]])


def _evidence(picture: Map, noise: Map, radius: float, power: float) -> Numbers:
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


def _peak(maps: Numbers, radii: Numbers, near: Mask | None = None) -> tuple[Circle, float]:
    """The circle of the largest value of maps (radii, H, W), between the samples, and that value."""
    looked = maps if near is None else np.where(near, maps, -1)
    i, y, x = (int(k) for k in np.unravel_index(int(looked.argmax()), maps.shape))
    radius = radii[i] * (radii[1] / radii[0]) ** parabola_offset(maps[:, y, x], i)
    at = x + parabola_offset(maps[i, y], x), y + parabola_offset(maps[i, :, x], y)
    return (*at, float(radius)), float(maps[i, y, x])


def _refined(change: Map, noise: Map, circle: Circle) -> Circle:
    """The circle found again in a part of the image where its radius is 12 px, twice."""
    noise = cv2.resize(noise, change.shape[1::-1])
    x, y, radius = circle
    for low, high in ((0.5, 1.2), (0.85, 1.18)):  # factors of the radius
        factor, reach = FINE / radius, 2.2 * radius
        left, top = int(max(0, x - reach)), int(max(0, y - reach))
        part = slice(top, int(y + reach) + 1), slice(left, int(x + reach) + 1)
        picture, there = _resized(change[part], factor), _resized(noise[part], factor)
        across = picture.shape[1] / change[part].shape[1], picture.shape[0] / change[part].shape[0]
        at = _scaled((x - left, y - top, radius), *across, factor)
        near = distances_px(picture.shape, *at[:2]) < 0.5 * FINE
        radii = FINE * np.geomspace(low, high, 7)
        best, _ = _peak(np.stack([_evidence(picture, there, r, 0.0) for r in radii]), radii, near)
        x, y, radius = _scaled(best, 1 / across[0], 1 / across[1], 1 / factor)
        x, y = x + left, y + top
    return x, y, radius


def _scaled(circle: Circle, across: float, down: float, factor: float) -> Circle:
    """A circle in a picture that is resized by a factor, whose pixels have their centers at integers."""
    return (circle[0] + 0.5) * across - 0.5, (circle[1] + 0.5) * down - 0.5, circle[2] * factor


def _resized(image: Map, factor: float) -> Map:
    kind = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, None, fx=factor, fy=factor, interpolation=kind))


def contact_samples(
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    zone: float = ZONE,
    *,
    total: int = TOTAL_SAMPLES,
) -> Samples:
    """Samples inside the contacts, labeled by the balls: about `total`, shared evenly by the presses."""
    parts = []
    for press, contact in zip(presses, contacts):
        rows, cols = press.pixels(contact, zone, max(200, total // len(presses)))
        parts.append(press.samples(rows, cols, press.ball_gradients(contact, rows, cols), 1.0))
    return joined(parts)


def training_samples(
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    zone: float = ZONE,
    *,
    total: int = TOTAL_SAMPLES,
) -> Samples:
    """The samples that models are fitted on: pixels inside the contacts, as `contact_samples`, and pixels at rest."""
    return with_rest_samples(contact_samples(presses, contacts, zone, total=total), presses, contacts)


def with_rest_samples(
    samples: Samples, presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle]
) -> Samples:
    """The samples and up to half as many of the gel at rest, where the gradient is 0, with a weight of 0.3."""
    parts = [samples]
    for press, contact in zip(presses, contacts):
        step = max(1, int(np.sqrt(2 * press.size.size * len(presses) / len(samples.x_px))))
        rows, cols = (
            axis.ravel() for axis in np.mgrid[: press.size.shape[0] : step, : press.size.shape[1] : step]
        )
        far = np.hypot(cols - contact.x_px, rows - contact.y_px) > REST_DISTANCE * contact.radius_px
        if press.usable is not None:
            far &= press.usable[rows, cols]
        rows, cols = rows[far], cols[far]
        parts.append(press.samples(rows, cols, np.zeros((len(rows), 2)), 0.3))
    return joined(parts)


def joined(parts: Sequence[Samples]) -> Samples:
    """Samples of images of one sensor, one after the other."""
    names = ["color_change", "x_px", "y_px", "gradients", "weight"]
    names += [] if parts[0].depth_px is None else ["depth_px"]
    columns: dict[str, Any] = {name: np.concatenate([getattr(one, name) for one in parts]) for name in names}
    return replace(parts[0], **columns)
