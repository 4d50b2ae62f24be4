"""Faults of a frame, as named findings with figures; a degraded frame never raises an exception."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.arrays import Array, Image, Map, Mask
from gelform.errors import CalibrationError, Finding
from gelform.foundations.checks import value_range
from gelform.foundations.filters import CHANGE_OFFSET
from gelform.image.view import DARK, PIXEL_VARIANCE, as_levels

BLOCK_PX = 16  # px, a block of JPEG with halved color resolution; parts of a frame are lost in such blocks

_blocks = Kernel(
    "health_blocks",
    "u8[h,w,3] image, out u8[bh,bw,3] means, out u8[bh,bw] ranges, out i64[h] digests, out u16[h,bw,3] sums",
)


@dataclass(frozen=True)
class ImageBlocks:
    """An image (H, W) in h x w whole blocks of 16x16 pixels."""

    means: NDArray[np.uint8]  # (h, w, 3) uint8, gray levels
    # (h, w) uint8: largest minus smallest value within a block, in the channel with the largest range. Noise alone
    # gives 3 or more.
    ranges: NDArray[np.uint8]
    row_digests: NDArray[np.int64]  # (H,) int64: rows of equal pixels have equal digests
    row_sums: NDArray[np.uint16]  # (H, w, 3) uint16, sums over 16 pixels of a row, gray levels

    def pixels(self, chosen: Mask, width: int) -> Mask:
        """The pixels (H, W) of selected blocks (h, w); the remainder at the border belongs to the last block."""
        mask = np.zeros((len(self.row_digests), width), dtype=bool)
        if chosen.any():
            rows = np.minimum(np.arange(mask.shape[0]) // BLOCK_PX, chosen.shape[0] - 1)
            columns = np.minimum(np.arange(width) // BLOCK_PX, chosen.shape[1] - 1)
            mask |= chosen[rows[:, None], columns[None, :]]
        return mask


def blocks_from_image(image: Image) -> ImageBlocks:
    """The blocks of an image (H, W, 3)."""
    arrays = _block_arrays(image)
    _blocks(image, *arrays)
    return ImageBlocks(*arrays)


def _block_arrays(image: Image) -> tuple[Any, ...]:
    """The arrays of an image's blocks, unset."""
    height, width = image.shape[:2]
    rows, columns = height // BLOCK_PX, width // BLOCK_PX
    means, ranges = np.empty((rows, columns, 3), np.uint8), np.empty((rows, columns), np.uint8)
    return means, ranges, np.empty(height, np.int64), np.empty((height, columns, 3), np.uint16)


# Gray levels of the background image's block: from LIT on it can be too dark, below BELOW saturated.
LIT, BELOW = 16, 240
CHANNELS = ("red", "green", "blue")


class Levels:
    """Finds dark and saturated blocks of frames; prepared once for a background image, of which `rest` are the blocks.

    One channel is enough for a block to count, because slopes need all three lights. A block (h, w, 3) with a mean below
    `dark_to` is dark, from `saturated_from` on saturated. A saturated one begins at 252: lower ones still show slopes of a
    bright gel.
    """

    def __init__(self, rest: ImageBlocks) -> None:
        # Levels are compared as integers of the blocks' own type, which cannot hold -1 or 256.
        self.dark_to = np.where(rest.means >= LIT, DARK, 0).astype(np.uint8)
        self.saturated_from = np.where(rest.means < BELOW, 252, 255).astype(np.uint8)
        self._may_saturate = rest.means < BELOW

    def __call__(
        self, blocks: ImageBlocks, torn: Mask | None = None
    ) -> tuple[tuple[Finding, ...], Mask | None]:
        """Findings `dark` and `saturated`, and their blocks (h, w) without the torn ones; None if there are none.

        A finding's figure is the fraction of the frame in the channel with the largest fraction.
        """
        dark = blocks.means < self.dark_to
        saturated = blocks.means >= self.saturated_from
        if not (dark.any() or saturated.any()):
            return (), None
        saturated &= self._may_saturate
        if torn is not None:
            dark[torn] = saturated[torn] = False
        findings = []
        for name, where, what, advice in (
            ("dark", dark, f"below {DARK} of 255 gray levels", "Is a light off, or the lens covered?"),
            ("saturated", saturated, "at the camera's upper end", "Lower exposure, gain or the lights."),
        ):
            fractions = where.mean(axis=(0, 1))
            if fractions.max() < 0.05:  # on good sensors a hard contact saturates or shades less
                continue
            shares = zip(CHANNELS, fractions)
            said = ", ".join(f"{channel} {100 * share:.0f} %" for channel, share in shares if share > 0)
            message = f"Parts of the frame are {what}: {said}. {advice}"
            findings.append(Finding(name, message, float(fractions.max())))
        return tuple(findings), np.any(dark | saturated, axis=-1) if findings else None


FLAT_RANGE = 2  # gray levels within a block; a camera's noise alone gives more
LEAST_TORN = 0.03  # smallest fraction of the frame


class Torn:
    """Finds parts of frames that contain no picture; prepared once for a background image and its blocks."""

    def __init__(self, background: Array, rest: ImageBlocks) -> None:
        self._background = background
        self._rest = rest.means.astype(np.int16)
        self._rest_sums = rest.row_sums.reshape(len(rest.row_sums), -1)
        _, place, count = np.unique(rest.row_digests, return_inverse=True, return_counts=True)
        # Rows that occur only once in the background image.
        self._own_rows = count.ravel()[place.ravel()] == 1

    def __call__(self, blocks: ImageBlocks, image: Array, seam: int) -> Mask | None:
        """Pixels (H, W) that did not arrive; None if all did. Below the row `seam` is another moment; 0: no such row."""
        flat, repeated = self.flat(blocks), self.repeated_rows(blocks, image)
        row = seam if flat is None and repeated is None else 0
        if flat is None and repeated is None and not row:
            return None
        torn = np.zeros(image.shape[:2], dtype=bool) if flat is None else blocks.pixels(flat, image.shape[1])
        if repeated is not None:
            torn[repeated] = True
        if row:  # the side of the seam that fits the background image worse
            sums = blocks.row_sums.reshape(self._rest_sums.shape)
            away = np.abs(np.subtract(sums, self._rest_sums, dtype=np.int32)).mean(axis=1)
            below = np.arange(len(away)) >= row
            torn[below if away[below].mean() > away[~below].mean() else ~below] = True
        return torn

    def flat(self, blocks: ImageBlocks) -> Mask | None:
        """Blocks (h, w) of one uniform color that is not the background image's; None if they are few."""
        flat = blocks.ranges <= FLAT_RANGE
        least = LEAST_TORN * flat.size
        if np.count_nonzero(flat) <= least:
            return None
        means = blocks.means.astype(np.int16)
        flat &= np.abs(means - self._rest).max(axis=-1) > 10
        if np.count_nonzero(flat) <= least:
            return None
        common = np.median(means[flat], axis=0)
        flat &= np.abs(means - common).max(axis=-1) <= 4
        return flat if np.count_nonzero(flat) > least else None

    def repeated_rows(self, blocks: ImageBlocks, image: Array) -> Mask | None:
        """Rows (H,) that repeat another row of the frame; None if they are few.

        Among equal rows, the one that fits the background image best counts as the true one. Compression makes rows within
        a block equal.
        """
        order = np.sort(blocks.row_digests)
        least = LEAST_TORN * len(order)
        if np.count_nonzero(order[1:] == order[:-1]) <= least:
            return None
        repeated = np.zeros(len(order), dtype=bool)
        for digest in np.unique(order[1:][order[1:] == order[:-1]]):
            rows = np.flatnonzero((blocks.row_digests == digest) & self._own_rows)
            if len(rows) > 1 and rows[-1] - rows[0] >= BLOCK_PX - 1:
                away = np.abs(image[rows].astype(np.float32) - self._background[rows]).mean(axis=(1, 2))
                repeated[np.delete(rows, int(np.argmin(away)))] = True
        return repeated if np.count_nonzero(repeated) > least else None


# A seam is a row below which everything belongs to another moment. There the change from the background image steps from
# one row to the next, further than at any other row. An object's edge, even one along the rows, is blurred over several
# rows, and markers and compression step at many.
#
# The squared step, summed over its row, is 3 times that of any other row or more: real frames of twelve sensors reach 2.3,
# with dots, ridges and compression. At most an eighth of it is in the rows beside it: an edge that optics blur by 0.6 px
# leaves 0.16. The usual step of 16 pixels' mean counts as 0.25 gray levels at least; whole levels alone give 0.16. The
# kernel counts twice the step of their sum.
SEAM_FACTOR, SEAM_SPILL, LEAST_STEP = 3.0, 0.125, 2 * BLOCK_PX * 0.25

_health = Kernel(
    "health_of_frame",
    "u8[h,w,3] image, u8[bh,bw,3] dark_to, u8[bh,bw,3] saturated_from, u16[h,bw,3] rest, f32[h,3]? gray, f32[h,4]? smooth, "
    "out u8[bh,bw,3] means, out u8[bh,bw] ranges, out i64[h] digests, out u16[h,bw,3] sums, out f64[4] signs, "
    "out f32[n] work, i32 flat, f32 least, f32 factor, f32 spill",
)


@dataclass(frozen=True, eq=False)
class FrameFaults:
    """The faults of a frame."""

    image: Array  # (H, W, 3), with the background image in place of lost pixels, so that these give no slopes
    # `dark`, `saturated`, `torn` (figure: fraction of the frame), `frozen` (figure 1), `bands` (gray levels)
    findings: tuple[Finding, ...] = ()
    # (H, W) bool, pixels without information, including a margin around torn parts; None if there are none
    lost: Mask | None = None


class Bands:
    """Finds bands along the camera's rows: light that flickers while they are read, or interference.

    A band is alike in all channels and from edge to edge. So it is what the rows' means in the left, the middle and the
    right third of the image have in common. What they differ by is everything else: noise, contacts, colors. A smooth
    change along the image is light.
    """

    def __init__(self, rest: ImageBlocks, pixels: Image, is_turned: bool) -> None:
        self._is_turned = is_turned  # whether the camera's rows are columns of the image
        self._rest = self._rows(rest, pixels)
        powers = np.vander(np.linspace(-1, 1, len(self._rest)), 4, increasing=True)
        # There are three strips at least, and more rows than the light's smooth change takes.
        self._can_tell = self._rest.shape[1] >= 3 and powers.shape[0] > powers.shape[1]
        # What the kernel tells the bands of an image by that is not turned: the first of `_common` of the gray levels.
        self.known: tuple[Map, Map] | tuple[None, None] = None, None
        if not self._can_tell:
            return
        self._gray = _gray_of_thirds(self._rest)
        self._smooth = np.ascontiguousarray(np.linalg.qr(powers)[0], dtype=np.float32)
        if not is_turned:
            self.known = self._gray, self._smooth

    def __call__(self, blocks: ImageBlocks, image: Array, common: float) -> tuple[Array, tuple[Finding, ...]]:
        """The image (H, W, 3) without bands, and the finding `bands`: amplitude, gray levels."""
        # First the question that costs little: nothing is in common that a camera's own gray levels would show.
        if not self._can_tell or common < 0.5:
            return image, ()
        rows, rest = self._rows(blocks, image), self._rest
        gray = _gray_of_thirds(rows)
        gain = self._gray.mean() / max(gray.mean(), np.float32(1))
        if self._common(gain * gray - self._gray)[0] < 0.5:
            return image, ()
        change = gain * rows - rest
        best, levels, band, multiplies = 1.0, 0.0, np.empty(0, dtype=np.float32), False
        whole = 3 * (rest.shape[1] // 3)
        for divides, divisor in ((True, rest + np.float32(CHANGE_OFFSET)), (False, np.ones_like(rest))):
            strips = self._flat(change / divisor)
            thirds = np.median(strips[:, :whole].reshape(len(rows), 3, -1, 3), axis=2)
            common, _ = self._common(thirds.mean(axis=-1))
            off = strips - np.median(thirds.mean(axis=-1), axis=1)[:, None, None]
            apart = float(np.median(np.square(off).mean(axis=(0, 2))))
            if (ratio := common / max(apart, 1e-12)) > best:
                best, multiplies = ratio, divides
                levels = np.sqrt(2 * common) * (float(rest.mean()) if divides else 1.0)
                # Where there are bands, what is curved along the rows is theirs rather than the light's.
                thirds = np.median((change / divisor)[:, :whole].reshape(len(rows), 3, -1, 3), axis=2)
                band = np.median(self._flat(thirds, 2), axis=1).mean(axis=-1)
        if levels < 1:
            return image, ()
        message = (
            f"Bands of {levels:.1f} gray levels lie along the camera's rows, as of lamps that flicker or of interference. "
            "gelform takes them out as far as the image shows them. Power the LEDs with direct current, or set the exposure "
            "to whole periods of the mains."
        )
        along = band[None, :, None] if self._is_turned else band[:, None, None]
        without = image / (1 + along) if multiplies else image - along
        return np.clip(without, 0, 255).astype(np.float32), (Finding("bands", message, float(levels)),)

    def _rows(self, blocks: ImageBlocks, image: Array) -> Map:
        """Gray levels (rows, strips, 3) of the camera's rows, averaged over strips of 16 px."""
        if not self._is_turned:
            return blocks.row_sums * np.float32(1 / BLOCK_PX)
        size = image.shape[1], image.shape[0] // BLOCK_PX
        strips = (
            cv2.resize(image, size, interpolation=cv2.INTER_AREA) if size[1] else np.empty((0, size[0], 3))
        )
        return np.ascontiguousarray(np.swapaxes(strips, 0, 1), dtype=np.float32)

    def _flat(self, rows: Map, terms: int = 4) -> Map:
        """Values (rows, ...) without their polynomial along the rows; by default the cubic."""
        columns, smooth = rows.reshape(len(rows), -1), self._smooth[:, :terms]
        return np.asarray(columns - smooth @ (smooth.T @ columns), dtype=np.float32).reshape(rows.shape)

    def _common(self, thirds: Map) -> tuple[float, float]:
        """Variance that the values (rows, 3) of all thirds have in common, and the mean of what each has beyond."""
        flat = self._flat(thirds)
        products = flat.T @ flat / len(flat)
        pairs = products[[0, 1, 2], [1, 2, 0]]
        return float(pairs.min()), float(np.trace(products) / 3 - pairs.mean())


def _gray_of_thirds(rows: Map) -> Map:
    """Mean gray levels (rows, 3) of the left, middle and right strips of (rows, strips, 3)."""
    each = rows.shape[1] // 3
    return np.asarray(rows[:, : 3 * each].reshape(len(rows), 3, -1).mean(axis=2), dtype=np.float32)


class FrameHealth:
    """Finds faults of the frames of one sensor, from its background image (H, W, 3), 0-255; threads can share it.

    It is a pure function of the frame; a stream finds faults that need memory, such as a camera that repeats one image.
    Only a repetition of the background image itself is found here. `is_turned`: whether the camera's rows are columns.
    """

    def __init__(self, background: Array, is_turned: bool = False) -> None:
        self._background = background
        self._pixels = as_levels(background)
        self._rest = rest = blocks_from_image(self._pixels)
        self._bands = Bands(rest, self._pixels, is_turned)
        self._levels = Levels(rest)
        self._torn = Torn(background, rest)
        rows = len(rest.row_sums)
        self._work_size = max(3 * rows, rows + 3 * rest.row_sums[0].size)

    def __call__(self, image: Array) -> FrameFaults:
        """The faults of an image (H, W, 3), RGB, 0-255, of the background's size."""
        blocks, seam, (flat, ending, repeated, common) = self._signs(as_levels(image))
        if blocks.row_digests[0] == self._rest.row_digests[0] and np.array_equal(image, self._background):
            message = "The frame equals the background image in every pixel. The camera is frozen, or it is that image."
            return FrameFaults(image, (Finding("frozen", message, 1.0),))
        few_flat, few_repeated = flat <= LEAST_TORN * blocks.ranges.size, repeated <= LEAST_TORN * len(image)
        if few_flat and few_repeated and not ending and not seam:  # as nearly every frame
            return FrameFaults(*self._bands(blocks, image, common))
        torn = self._torn(blocks, image, seam)
        # A whole frame of one color is dark or saturated if the color is an end of the range.
        if torn is not None and torn.mean() > 0.95 and self._levels(blocks)[1] is not None:
            torn = None
        lost, findings = np.zeros(image.shape[:2], dtype=bool), []
        if torn is not None:
            fraction = float(torn.mean())
            message = (
                f"{100 * fraction:.0f} % of the frame is torn: it has one color, repeats other rows, or is of another "
                "moment. Check the cable, and whether other devices share the camera's bandwidth."
            )
            findings.append(Finding("torn", message, fraction))
            # With the blocks around, because a fault may cut blocks in two.
            lost |= cv2.dilate(torn.view(np.uint8), np.ones((2 * BLOCK_PX + 1,) * 2, dtype=np.uint8)) > 0
            (height, width), middle = blocks.ranges.shape, BLOCK_PX // 2
            torn = torn[middle::BLOCK_PX, middle::BLOCK_PX][:height, :width]  # at the blocks' centers
        levels, clipped = self._levels(blocks, torn)
        if clipped is not None:
            lost |= blocks.pixels(clipped, image.shape[1])
        if torn is None and clipped is None:
            return FrameFaults(*self._bands(blocks, image, common))
        return FrameFaults(np.where(lost[..., None], self._pixels, image), (*findings, *levels), lost)

    def _signs(self, pixels: Image) -> tuple[ImageBlocks, int, list[float]]:
        """The blocks of an image (H, W, 3), its seam, and the other signs of faults that the kernel names."""
        blocks, signs = _block_arrays(pixels), np.empty(4)
        seam = _health(
            pixels, self._levels.dark_to, self._levels.saturated_from, self._rest.row_sums, *self._bands.known, *blocks,
            signs, np.empty(self._work_size, np.float32), flat=FLAT_RANGE, least=LEAST_STEP, factor=SEAM_FACTOR,
            spill=SEAM_SPILL,
        )  # fmt: skip
        return ImageBlocks(*blocks), seam, signs.tolist()


def check_untouched_image(image: Array, calibrated: Array) -> None:
    """Refuse a background image (H, W, 3) with parts that are dark, saturated or torn compared with the calibration's.

    CalibrationError: its message contains the finding.
    """
    faults = FrameHealth(calibrated)(image)
    if faults.lost is not None:
        raise CalibrationError(
            f"This image cannot be a background. {faults.findings[0].message} Take it again, with nothing touching the gel."
        )


@dataclass(frozen=True)
class DepthLimit:
    """The largest possible depth, mm."""

    limit_mm: float  # the gel's thickness if known, else the shorter side of the field of view
    is_thickness: bool  # whether it is the thickness

    @classmethod
    def of(cls, shape: tuple[int, int], mm_per_px: float, thickness_mm: float | None = None) -> DepthLimit:
        """The limit of images (H, W) of square pixels."""
        if thickness_mm is not None:
            return cls(float(thickness_mm), True)
        return cls(min(shape) * float(mm_per_px), False)

    @property
    def ignorance_mm(self) -> float:
        """Standard deviation of a depth about which only the limit is known: that of a uniform distribution."""
        return self.limit_mm * sqrt(PIXEL_VARIANCE)

    def bound(self, depth_mm: Map) -> tuple[Map, tuple[float, float], tuple[Finding, ...]]:
        """Clip the depth (H, W) to plus and minus the limit; its range then, mm, and a finding if that changed it."""
        low, high = value_range(depth_mm)
        largest = max(high, -low)
        if largest <= self.limit_mm:
            return depth_mm, (low, high), ()
        what = "thickness of the gel" if self.is_thickness else "width of the field of view"
        message = (
            f"Depth reaches {largest:.3g} mm, more than the {what} ({self.limit_mm:.3g} mm), and is cut there. "
            "The image does not fit the calibration. Do not trust this depth."
        )
        limit = np.float32(self.limit_mm)
        bounded = np.clip(depth_mm, -limit, limit)
        return bounded, value_range(bounded), (Finding("beyond_gel", message, largest),)
