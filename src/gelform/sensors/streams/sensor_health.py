"""What only a sequence of frames shows: faults of a sensor (marks, another gel, a lamp, a lost rate), and slow drift.

The background image is updated while nothing touches the gel. A slow change comes either from the sensor (LEDs that warm
up, a gel that relaxes) or from a slow press. The two look alike for a while. Shape and time tell them apart:

- The light, its tilt over the image and the room's light (`light_at_rest`) are followed within seconds. No contact is that
  wide when it begins.
- Everything else waits in quarantine: an average over 10 s becomes part of the background only where nothing touched for
  30 s before it *and* for 60 s after it (`Touched`, with a margin). By then even a slight slow press is detected, so that
  none of it enters the background.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform import Calibration, DataError, GelformError, Grabber, Reconstruction, background_from_frames
from gelform.arrays import Array, Map, Mask, Numbers
from gelform.errors import Finding
from gelform.foundations.filters import robust_sigma
from gelform.image.agreement import room_light_finding
from gelform.image.background import USUAL_FRAMES
from gelform.image.light import FrameLight, block_means, light_at_rest, light_from_blocks, lit, without_light
from gelform.image.registration import PreparedRegistration
from gelform.image.view import PIXEL_VARIANCE
from gelform.sensors import Source, settings_mismatch

STEP_S, MEAN_S = 1.0, 3.0  # s: interval of the light's fits, and averaging time of the blocks for them
MEAN_IMAGE_S = 10.0  # s over which frames are averaged before they wait
BEFORE_S, AFTER_S = 30.0, 60.0  # s without touch around a mean image; AFTER_S is its time constant, too
LEAST_FREE = 0.9  # fraction of the blocks that must be free of contact to fit the light, which the gel's halo resembles
NO_MEASURE = {"beyond_gel", "dark", "exposure_unknown", "frozen", "saturated", "torn"}
DIFFERENT = {"background_differs", "few_untouched", "not_this_gel"}  # contact all over, or another gel
REFUSED = "background_refused"
PER_GRAY_LEVEL = 256  # steps per gray level of a waiting mean image

TOUCH_SIGMAS = 5.0  # standard deviations of noise by which a touched block changes
LEAST_CHANGE = 0.0025  # fraction of a block's brightness: slopes of about 0.2 %
LONG_S = 10.0  # s, averaging time for slight changes
MOST_CHANGE = 0.01  # limit of such an average, so that a strong change does not stay in it
MARGIN = 0.1  # fraction of the image's shorter side: around a contact the gel sinks or rises


@dataclass(frozen=True, eq=False)
class DriftEvidence:
    """The mean of the frames of about ten seconds."""

    image: Map  # (H, W, 3), mean of the frames, 0-255
    start: Map  # (H, W, 3), the background at the start of the sequence
    lit: Map  # (H, W, 3), that background in the light of now
    touched: Mask  # (H, W), where something may have touched meanwhile, with a margin
    contact: Mask  # (H, W), where a frame showed contact
    different: float = 0.0  # fraction of the frames that differ from the background nearly everywhere


@dataclass(frozen=True, eq=False)
class MeanImage:
    """A mean image without the smooth light that waits to become background: (H, W, 3), in 1/256 gray level."""

    start_s: float
    end_s: float
    image: NDArray[np.uint16]


class BackgroundDrift:
    """The current background; a function of the sequence of images and results.

    It begins with `background` (H, W, 3), 0-255. One that is taken is compared with the calibration's, `calibrated`, by
    default the same.
    """

    def __init__(self, background: Map, calibrated: Map | None = None) -> None:
        self.start = background
        self._calibrated = background if calibrated is None else calibrated
        # What is doubted of the background that was asked for last, and whether it was taken; of the last that was taken.
        self.doubts: tuple[Finding, ...] = ()
        self.findings: tuple[Finding, ...] | None = None
        self._local = background.astype(np.float32)
        self._local_blocks = block_means(self._local)
        self.light = np.zeros((3, 4))  # the followed light relative to the start, as in `lit`
        # Light of the last second relative to the current background, which can follow it only where nothing touches.
        self.usual: FrameLight | None = None
        self.touched = Touched(self._local_blocks.shape[:2])
        self._mean: Map | None = None
        self._waiting: deque[MeanImage] = deque()
        self._last_s: float | None = None
        # Set to take the next frames, of a second at most, as background, from any thread, because nothing touches now.
        self.asked = self._taking = self._touch_refused = False
        self._contact_long = np.zeros(background.shape[:2], dtype=bool)
        self.evidence: DriftEvidence | None = None  # of the last complete ten seconds
        self._start_anew(0.0)

    @property
    def gains(self) -> Numbers:
        """The mean light of each channel (3,) relative to the start."""
        rest = self._local_blocks
        return np.asarray(lit(rest, self.light).mean(axis=(0, 1)) / rest.mean(axis=(0, 1)), dtype=np.float64)

    @property
    def taking(self) -> bool:
        """Whether a background that was asked for is not decided yet."""
        return self.asked or self._taking

    def __call__(self, image: Array, result: Reconstruction) -> Map | None:
        """Learn from a frame; the background (H, W, 3) if it has changed, else None."""
        time_s = result.time_s or 0.0
        # After 5 s without a frame the past is unknown.
        if self._last_s is None or not 0 <= time_s - self._last_s <= 5.0:
            self.touched.everywhere(time_s)
            self._forget(time_s)
        self._last_s = time_s
        if self.asked:
            self._taking, self.asked = True, False  # in this order: `taking` is read in other threads
            self._start_anew(time_s)
        names = {finding.name for finding in result.health}
        if names & NO_MEASURE:
            self._contact |= True
            return None
        self._blocks += block_means(image)
        self._count += 1
        cv2.accumulate(image, self._sum)
        self._sum_count += 1
        self._contact |= result.contact
        self._contact_long |= result.contact
        if names & DIFFERENT:
            self._contact |= True
            self._different += 1
        if self._taking and len(self._at_rest) < USUAL_FRAMES:
            self._at_rest.append(image)
        if time_s - self._step_s < STEP_S:
            return None
        if not self._taking:
            return self._step(time_s)
        taken = self._taken(time_s)
        self._taking = False
        return taken

    def _taken(self, time_s: float) -> Map | None:
        """Start again from the frames since the request; None if something seems to touch the gel in them, or they disagree.

        A second request in a row takes a touched one all the same.
        """
        figure = 1.0
        try:
            taken = background_from_frames(self._at_rest, untouched=self._calibrated)
            self._touch_refused = taken.touch is not None and not self._touch_refused
            if taken.touch is not None and self._touch_refused:
                figure = taken.touch.figure
                raise DataError(f"{taken.touch.message} Or ask once more: then it is taken as it is.")
        except GelformError as problem:
            self.doubts = (Finding(REFUSED, f"The background was not taken. {problem}", figure),)
            self._start_anew(time_s)
            return None
        self.doubts = self.findings = taken.findings
        self.start = self._local = taken.background
        self._local_blocks = block_means(self._local)
        self.light, self.usual = np.zeros((3, 4)), None
        self.touched.everywhere(-np.inf)
        self._forget(time_s)
        return self._local.copy()

    def _forget(self, time_s: float) -> None:
        """Start anew, without what was averaged or waits."""
        self._waiting.clear()
        self._mean = None
        self._start_anew(time_s)

    def _start_anew(self, time_s: float) -> None:
        """Start a new step and a new mean image."""
        self._step_s = self._mean_image_s = time_s
        self._at_rest: list[Array] = []  # frames of a background that was asked for
        self._blocks = np.zeros_like(self._local_blocks)
        self._contact = np.zeros(self._local.shape[:2], dtype=bool)
        self._sum = np.zeros_like(self._local)
        self._count = self._sum_count = self._different = 0

    def _step(self, time_s: float) -> Map | None:
        """Fit the light, mark touched blocks, and add the mean images that have waited long enough."""
        step_s, blocks = time_s - self._step_s, self._blocks * np.float32(1 / self._count)
        size = blocks.shape[1::-1]
        contact = cv2.resize(self._contact.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0
        free = self.touched.not_since(time_s - MEAN_S) & ~contact
        if self._mean is None:
            self._mean = blocks
        else:
            self._mean += np.float32(-np.expm1(-step_s / MEAN_S)) * (blocks - self._mean)
        # Follow the light of the free blocks; the others are 0.
        seen, untouched = np.where(free[..., None], self._mean, np.float32(0)), self._local_blocks
        usual = light_from_blocks(seen, lit(untouched, self.light), self.usual)
        self.usual = usual if usual.is_known else None
        if free.mean() >= LEAST_FREE and self.usual is not None:
            self.light, self.usual = light_at_rest(seen, untouched, self._now), None
        now = lit(self._local_blocks, self._now)
        self.touched.mark(time_s, step_s, contact, blocks / now - 1, now)
        if time_s - self._mean_image_s >= MEAN_IMAGE_S:
            self._keep_mean_image(time_s)
        self._take_in(time_s)
        self._step_s = time_s
        self._blocks[:], self._count = 0, 0
        self._contact[:] = False
        # The fitted light can exceed a camera's largest gray level.
        return np.asarray(np.clip(lit(self._local, self.light), 0, 255), dtype=np.float32)

    @property
    def _now(self) -> Numbers:
        """The light relative to the start, in parts followed, in parts only known."""
        return self.light if self.usual is None else self.light + self.usual.values

    def _keep_mean_image(self, time_s: float) -> None:
        mean = self._sum * np.float32(1 / self._sum_count)
        touched = (~self.touched.not_since(self._mean_image_s)).astype(np.uint8)
        shape = self._local.shape[1::-1]
        self.evidence = DriftEvidence(
            image=mean,
            start=self.start,
            lit=lit(self.start, self._now),
            touched=cv2.resize(touched, shape, interpolation=cv2.INTER_NEAREST).astype(bool),
            contact=self._contact_long.copy(),
            different=self._different / self._sum_count,
        )
        image = without_light(mean, self.light) * np.float32(PER_GRAY_LEVEL)
        levels = np.clip(np.rint(image), 0, 255 * PER_GRAY_LEVEL).astype(np.uint16)
        self._waiting.append(MeanImage(self._mean_image_s, time_s, levels))
        self._mean_image_s = time_s
        self._sum[:], self._sum_count, self._different = 0, 0, 0
        self._contact_long[:] = False

    def _take_in(self, time_s: float) -> None:
        """Add mean images that have waited to the background, where nothing touched around their time."""
        while self._waiting and self._waiting[0].end_s + AFTER_S <= time_s:
            waited = self._waiting.popleft()
            free = self.touched.not_since(waited.start_s - BEFORE_S).astype(np.float32)
            fraction = cv2.resize(free, self._local.shape[1::-1], interpolation=cv2.INTER_LINEAR)
            span_s = waited.end_s - waited.start_s
            fraction *= np.float32(-np.expm1(-span_s / AFTER_S))
            image = waited.image.astype(np.float32) * np.float32(1 / PER_GRAY_LEVEL)
            self._local += fraction[..., None] * (image - self._local)
            self._local_blocks = block_means(self._local)


class Touched:
    """The time of the last touch, or possible touch, of each block of a grid (h, w)."""

    def __init__(self, blocks: tuple[int, ...]) -> None:
        self._last_s = np.full(blocks, -np.inf)
        self._long = np.zeros((*blocks, 3), dtype=np.float32)
        reach = max(1, round(MARGIN * min(blocks)))
        self._kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)

    def mark(self, time_s: float, step_s: float, contact: Mask, change: Map, untouched: Map) -> None:
        """Find and remember the blocks (h, w) that may be touched at this time, `step_s` after the last, with the margin.

        Those are blocks in which a frame shows contact, and those whose brightness stands out from all blocks, in the last
        second or in the mean of about ten. `change` (h, w, 3) is relative, against the background in the current light, of
        which `untouched` (h, w, 3) has the gray levels.
        """
        slight = np.clip(change, -MOST_CHANGE, MOST_CHANGE)
        self._long += np.float32(-np.expm1(-step_s / LONG_S)) * (slight - self._long)
        touched = contact | _drift_stands_out(change, untouched) | _drift_stands_out(self._long, untouched)
        self._last_s[cv2.dilate(touched.astype(np.uint8), self._kernel) > 0] = time_s

    def everywhere(self, time_s: float) -> None:
        """Mark every block as touched at that time, because no frame was available; -inf: forget all touches."""
        self._last_s[:] = time_s

    def not_since(self, time_s: float) -> Mask:
        """The blocks (h, w) without a touch since that time."""
        return self._last_s < time_s


def _drift_stands_out(change: Map, untouched: Map) -> Mask:
    """The blocks (h, w) that changed by more than drift and noise; noise is equal in gray levels."""
    size = np.abs(change)
    levels = size * untouched
    noise = robust_sigma(levels, axis=(0, 1))
    odd = (levels > TOUCH_SIGMAS * noise) & (size > LEAST_CHANGE)
    return np.asarray(odd.any(axis=-1))


SMOOTH_PX, WIDE_PX = 1.0, 8.0  # px, widths of the blur of the image and of its surroundings
MARK_SIGMAS, LEAST_MARK_CHANGE = 6.0, 0.04  # standard deviations of noise; least fraction of the brightness
MARK_STAYS = 3  # consecutive evidences, about ten seconds each
LONG_PX, THIN = 10.0, 0.4  # a scratch: least length, px, and largest width / length; or ...
GROOVE_THIN, BOTH_SIGNS = 0.6, 0.4  # ... width / length, if it is bright on one side and dark on the other
TORN, TORN_AREA = 0.2, 0.0045  # a tear: fraction of the brightness, all channels; of the image
DARK = 0.06  # mean loss of light by dust, a fraction; a slight bright spot does no harm
BODY_PX = 15  # px; a wider contact is an object


class Marks:
    """Counts for how long each pixel has differed from the start without contact around it."""

    def __init__(self) -> None:
        self._stays: NDArray[np.uint8] | None = None

    def __call__(self, evidence: DriftEvidence) -> tuple[Finding, ...]:
        """Find `scratch`, `dust` and `tear`.

        Their figures are the largest one's length or diameter, px, and image fraction.
        """
        change = np.asarray(evidence.image / np.maximum(evidence.lit, 1) - 1, dtype=np.float32)
        odd = _stands_out(change, _near_a_body(evidence.contact))
        if self._stays is None:
            self._stays = np.zeros(odd.shape, np.uint8)
        self._stays[:] = np.where(_dilated(odd, 1), cv2.add(self._stays, 1), 0)
        largest = _largest_marks(odd & (self._stays >= MARK_STAYS), change, evidence.contact)
        findings = []
        for name, words in _WORDS.items():
            if name in largest:
                area, length, brighter = largest[name]
                share = area / odd.size
                message = words.format(length=length, percent=100 * share, change=100 * brighter)
                findings.append(Finding(name, message, share if name == "tear" else length))
        return tuple(findings)


_WORDS = {
    "scratch": "A new line of {length:.0f} px has stayed on the gel: a scratch, or a fiber. Depth along it is wrong.",
    "dust": "A new spot of {length:.0f} px has stayed on the gel: dust. Clean it.",
    "tear": "{percent:.1f} % of the image has become {change:+.0f} % brighter and has stayed so. The coating is torn or "
    "worn. Replace the gel.",
}


def _near_a_body(contact: Mask) -> Mask:
    """Pixels (H, W) in or near a contact that is wider than a mark: their relief belongs to the touching object."""
    map8 = contact.view(np.uint8)
    wide = cv2.morphologyEx(map8, cv2.MORPH_OPEN, np.ones((BODY_PX, BODY_PX), np.uint8))
    count, labels = cv2.connectedComponents(map8, connectivity=8)
    bodies = np.zeros(count, np.uint8)
    bodies[labels[wide > 0]] = 1
    return _dilated(bodies[labels], BODY_PX)


def _dilated(mask: Array, by_px: int) -> Mask:
    """A mask (H, W) with a square margin."""
    return np.asarray(cv2.dilate(mask.view(np.uint8), np.ones((2 * by_px + 1,) * 2, np.uint8)), dtype=bool)


def _stands_out(change: Map, near_a_body: Mask) -> Mask:
    """Pixels (H, W) that are torn, or differ far more than others from their wide surroundings, in any channel."""
    smooth = cv2.GaussianBlur(change, (0, 0), SMOOTH_PX)
    height, width = change.shape[:2]
    step = max(1, round(WIDE_PX / 2))
    small = cv2.resize(smooth, (max(1, width // step), max(1, height // step)), interpolation=cv2.INTER_AREA)
    wide = cv2.resize(cv2.medianBlur(small, 5), (width, height), interpolation=cv2.INTER_LINEAR)
    off = np.abs(smooth - wide)
    torn = np.abs(smooth).min(axis=-1) > TORN  # wider than the median's window
    noise = robust_sigma(off[::2, ::2], axis=(0, 1))
    odd = (off > np.maximum(MARK_SIGMAS * noise, LEAST_MARK_CHANGE)).any(axis=-1)
    return np.asarray((odd & ~near_a_body) | torn)


def _largest_marks(where: Mask, change: Map, contact: Mask) -> dict[str, tuple[int, float, float]]:
    """Of the largest mark of each name: its area and length, px, and the relative change, mean of all channels."""
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(where.view(np.uint8), connectivity=8)
    largest: dict[str, tuple[int, float, float]] = {}
    for label in range(1, count):
        area = int(boxes[label][cv2.CC_STAT_AREA])
        if area < 4:  # px: noise
            continue
        mine = labels == label
        name, length = _kind(mine, change[mine], area)
        brighter = float(change[mine].mean())
        if name == "dust" and brighter > -DARK:
            continue
        around = _dilated(mine, 8) & ~mine  # 8 px wide
        # With contact in half of its surroundings, an object rests on the gel, and the gel itself is unchanged.
        rests = name != "tear" and float(contact[around].mean()) > 0.5
        if not rests and (name not in largest or area > largest[name][0]):
            largest[name] = area, length, brighter
    return largest


def _kind(mine: Mask, change: Map, area: int) -> tuple[str, float]:
    """The name and the length, px, of a mark (H, W) whose pixels changed by (N, 3)."""
    y, x = np.nonzero(mine)
    covariance = np.cov(np.stack([x, y])) if area > 1 else np.zeros((2, 2))
    small, large = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0)) / np.sqrt(PIXEL_VARIANCE) + 1
    if area > TORN_AREA * mine.size and abs(change.mean()) > TORN:
        return "tear", float(large)
    sizes = np.abs(change).mean(axis=0)
    most = int(sizes.argmax())
    # In the channel that changed most, a groove is brighter and darker in equal measure.
    groove = float(abs(change[:, most].mean())) < BOTH_SIGNS * float(sizes[most])
    thin = GROOVE_THIN if groove else THIN
    return ("scratch" if large > LONG_PX and small < thin * large else "dust"), float(large)


MOVED_PX, TURNED_DEG = 0.5, 0.2  # least motion of a camera that moved
MOVED_SIGMAS = 4.0  # standard deviations of the registration that the motion must exceed
FINE_PX, COARSE_PX = 0.8, 2.0  # px, blur widths between which the texture lies
MARGIN_PX = round(3 * 2 * COARSE_PX)  # px at the border, three deviations of the widest blur
# Correlation of the texture: the least that is more than none, and the least fraction of the expected one for the same gel,
# which is small because a touch adds its own texture.
LEAST_ALIKE, SAME_FRACTION = 0.08, 0.4
PATTERN = 0.02  # fraction of the brightness, not explained by smooth light: median over blocks
MOSTLY_DIFFERENT, GEL_STAYS = 0.9, 3  # fraction of the frames of about ten seconds; consecutive times
OTHER_STAYS = 2  # consecutive times: a step of the light is not followed at once


class SameGel:
    """Compares a sequence's images with the background (H, W, 3), 0-255, at its start."""

    def __init__(self, start: Map) -> None:
        self._registration = PreparedRegistration(start)
        self._start = _texture(start)
        self._before: Map | None = None
        self._different = self._others = 0

    def __call__(self, evidence: DriftEvidence) -> tuple[Finding, ...]:
        """Find `camera_moved` (figure: px) or `other_gel` (figure: the difference, or the texture's correlation)."""
        texture, before = _texture(evidence.image), self._before
        self._before = texture
        self._different = self._different + 1 if evidence.different > MOSTLY_DIFFERENT else 0
        if self._different >= GEL_STAYS:
            return _other_gel("Nearly all of the image has differed from the background image for long", 0.0)
        free = ~evidence.touched
        free[:MARGIN_PX] = free[-MARGIN_PX:] = free[:, :MARGIN_PX] = free[:, -MARGIN_PX:] = False
        if free.mean() < 0.15:  # too little of the image to compare
            return ()
        if moved := self._moved(evidence):
            return moved
        other = self._other_pattern(evidence) or self._other_texture(texture, before, free)
        self._others = self._others + 1 if other else 0
        return other if self._others >= OTHER_STAYS else ()

    def _moved(self, evidence: DriftEvidence) -> tuple[Finding, ...]:
        # The slopes of this image must stay: those of a moved image look like light.
        gains = evidence.lit.mean(axis=(0, 1)) / evidence.start.mean(axis=(0, 1))
        found = self._registration(np.clip(evidence.image / gains, 0, 255), evidence.touched)
        by_px = found.moved_px(MOVED_SIGMAS)
        turned = abs(found.turn_deg) - MOVED_SIGMAS * found.turn_sigma_deg
        if by_px < MOVED_PX and turned < TURNED_DEG:
            return ()
        x, y = found.shift_px
        message = (
            f"The image has moved by {x:+.1f} px in x and {y:+.1f} px in y, and turned by {found.turn_deg:+.2f} degrees "
            "since the start. The camera, or the gel in its frame, has moved. Move it back, or calibrate again."
        )
        return (Finding("camera_moved", message, float(np.hypot(x, y))),)

    def _other_pattern(self, evidence: DriftEvidence) -> tuple[Finding, ...]:
        """A change of brightness nearly everywhere that smooth light does not explain."""
        height, width = evidence.touched.shape
        size = max(1, width // 16), max(1, height // 16)  # blocks of 16 px
        ratio = (evidence.image + 1) / (evidence.lit + 1) - 1
        blocks = cv2.resize(ratio, size, interpolation=cv2.INTER_AREA)
        free = cv2.resize(evidence.touched.astype(np.float32), size, interpolation=cv2.INTER_AREA) < 0.5
        off = float(np.median(np.abs(blocks[free]).max(axis=-1))) if free.any() else 0.0
        if off < PATTERN:
            return ()
        said = (
            f"Half of the gel at rest differs by {100 * off:.1f} % or more from the start in any smooth light"
        )
        return _other_gel(said, off)

    def _other_texture(self, now: Map, before: Map | None, free: Mask) -> tuple[Finding, ...]:
        """Texture that repeats from one evidence to the next, but differs from the start's."""
        if before is None:
            return ()
        stays = _correlation(now[free], before[free])
        expected = stays * float(np.std(now[free])) / max(float(np.std(self._start[free])), 1e-9)
        found = _correlation(now[free], self._start[free])
        if expected < LEAST_ALIKE or found > min(SAME_FRACTION * expected, LEAST_ALIKE):
            return ()
        said = f"The fine texture correlates with the calibration's by {found:.2f}, expected {min(expected, 1.0):.2f}"
        return _other_gel(said, found)


def _other_gel(said: str, figure: float) -> tuple[Finding, ...]:
    message = f"{said}. The gel or the sensor is not the calibrated one. Calibrate this one."
    return (Finding("other_gel", message, figure),)


def _texture(image: Map) -> Map:
    """Detail finer than 2 px and coarser than noise, (H, W): relative brightness, channels combined."""
    logs = np.log(image.mean(axis=-1) + 10)
    fine = cv2.GaussianBlur(logs, (0, 0), FINE_PX) - cv2.GaussianBlur(logs, (0, 0), COARSE_PX)
    fine -= cv2.GaussianBlur(fine, (0, 0), 2 * COARSE_PX)  # curved shading is no texture
    limit = MARK_SIGMAS * float(robust_sigma(fine))  # for a single speck of dust
    return np.asarray(np.clip(fine, -limit, limit), dtype=np.float32)


def _correlation(a: Map, b: Map) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt(np.dot(a, a) * np.dot(b, b)))
    return float(np.dot(a, b)) / size if size > 0 else 0.0


FROZEN = "frozen"
FROZEN_S, FROZEN_FRAMES = 0.25, 3  # s and frames: videos repeat some frames; noise makes all others differ
BRIGHTER = 0.08  # log of the gain of all channels: slopes stay good, but something changed
COLORED = 0.03  # log of one channel's gain relative to the others


def camera_findings(calibration: Calibration, camera: Source | Grabber) -> tuple[Finding, ...]:
    """Find `other_camera` and `settings_mismatch` from serial number and settings, as read back and as far as known.

    Their figures are 1, and the number of settings that differ from the calibration. A reconnected camera loses settings.
    """
    findings = []
    serial, calibrated = camera.serial, calibration.serial
    if serial and calibrated and serial != calibrated:
        message = (
            f"The camera's serial is {serial}, but the calibration is of {calibrated}. Colors differ from unit to "
            "unit. Use this unit's calibration, or calibrate it."
        )
        findings.append(Finding("other_camera", message, 1.0))
    if different := settings_mismatch(calibration.settings.camera or {}, camera.settings):
        said = ", ".join(f"{name} {now} instead of {then}" for name, (then, now) in different.items())
        message = f"The camera's settings differ from those at calibration: {said}. Restore them, or calibrate again."
        findings.append(Finding("settings_mismatch", message, float(len(different))))
    return tuple(findings)


class Frozen:
    """Counts for how long the images of a sequence have been equal, pixel by pixel."""

    def __init__(self) -> None:
        self._last: Array | None = None
        self._since_s = 0.0
        self._count = 0

    def __call__(self, image: Array, time_s: float) -> tuple[Finding, ...]:
        """The finding `frozen` (figure: duration, s), from the third equal image and 0.25 s on."""
        last, rows = self._last, slice(None, None, 16)  # a first check of some rows
        equal = last is not None and np.array_equal(image[rows], last[rows]) and np.array_equal(image, last)
        if not equal or time_s < self._since_s:
            self._last, self._since_s, self._count = image, time_s, 1
            return ()
        self._count += 1
        for_s = time_s - self._since_s
        if self._count < FROZEN_FRAMES or for_s < FROZEN_S:
            return ()
        message = f"The camera hangs: it has given the same image for {for_s:.1f} s. The depth is that of this image."
        return (Finding(FROZEN, message, for_s),)


def light_findings(gains: Numbers) -> tuple[Finding, ...]:
    """Find `brightness_shift` and `color_shift` by gains (3,) against the start; a figure is the largest gain minus 1."""
    logs = np.log(np.maximum(gains, 1e-3))
    said = ", ".join(f"{name} {100 * (gain - 1):+.1f} %" for name, gain in zip("RGB", gains))
    findings = []
    if abs(float(logs.mean())) > BRIGHTER:
        message = (
            f"The light has changed since the start ({said}): exposure, or the LEDs. gelform compensates it."
        )
        findings.append(Finding("brightness_shift", message, float(np.exp(logs.mean()) - 1)))
    apart = logs - np.median(logs)
    worst = int(np.argmax(np.abs(apart)))
    if abs(float(apart[worst])) > COLORED:
        message = f"The light's color has changed since the start ({said}): white balance or LED. gelform compensates it."
        findings.append(Finding("color_shift", message, float(np.exp(apart[worst]) - 1)))
    return tuple(findings)


def light_from_outside(evidence: DriftEvidence) -> tuple[Finding, ...]:
    """Find `room_light` against the start, off contact."""
    now, start = (
        block_means(np.where(evidence.contact[..., None], np.float32(0), image))
        for image in (evidence.image, evidence.start)
    )
    return room_light_finding(light_from_blocks(now, start))


class Examination:
    """Compares each evidence with the background of the start; remembers which findings persist."""

    def __init__(self) -> None:
        self._marks = Marks()
        self._same_gel: SameGel | None = None
        self._start: object = None

    def __call__(self, evidence: DriftEvidence) -> tuple[Finding, ...]:
        """Find `camera_moved`, `other_gel`, `room_light`, `scratch`, `dust`, `tear`.

        A cause hides its effects: under light from outside the gel looks like another one, and on a moved gel every
        speck is new.
        """
        if self._same_gel is None or evidence.start is not self._start:
            self._same_gel, self._marks, self._start = SameGel(evidence.start), Marks(), evidence.start
        return light_from_outside(evidence) or self._same_gel(evidence) or self._marks(evidence)
