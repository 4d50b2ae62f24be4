"""Whether the gel has moved and whether it is the same gel, by its fine texture, as by a fingerprint."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.foundations.filters import robust_sigma
from gelform.foundations.findings import Finding
from gelform.image.background.registration import PreparedRegistration
from gelform.sensors.streams.background_drift import DriftEvidence

MOVED_PX, TURNED_DEG = 0.5, 0.2  # least motion of a camera that moved
MOVED_SIGMAS = 4.0  # standard deviations of the registration that the motion must exceed
FINE_PX, COARSE_PX = 0.8, 2.0  # px, blur widths between which the texture lies
MARGIN_PX = 12  # px at the border that a blur distorts
# Correlation of the texture: least expected one, least fraction of it for the same gel, and the limit of that product.
# The fraction is small because a touch adds its own texture.
LEAST_EXPECTED, SAME_FRACTION, SAME_GEL = 0.08, 0.4, 0.07
LEAST_FREE = 0.15  # fraction of the image that must be free of contact
PATTERN = 0.02  # fraction of the brightness, not explained by smooth light: median over blocks
PATTERN_PX = 16  # px, width of these blocks
MOSTLY_DIFFERENT, GEL_STAYS = 0.9, 3  # fraction of the frames of about ten seconds; consecutive times
OTHER_STAYS = 2  # consecutive times: a step of the light is not followed at once


class SameGel:
    """Compares a sequence's images with the background at its start.

    Parameters
    ----------
    start : (H, W, 3) float32, 0-255
    """

    def __init__(self, start: NDArray[np.float32]) -> None:
        self._registration = PreparedRegistration(start)
        self._start = _texture(start)
        self._before: NDArray[np.float32] | None = None
        self._different = self._others = 0

    def __call__(self, evidence: DriftEvidence) -> tuple[Finding, ...]:
        """Find `camera_moved` (figure: px) or `other_gel` (figure: the difference, or the texture's correlation)."""
        texture, before = _texture(evidence.image), self._before
        self._before = texture
        self._different = self._different + 1 if evidence.different > MOSTLY_DIFFERENT else 0
        if self._different >= GEL_STAYS:
            return (
                _other_gel("Nearly all of the image has differed from the background image for long", 0.0),
            )
        free = ~evidence.touched
        free[:MARGIN_PX] = free[-MARGIN_PX:] = free[:, :MARGIN_PX] = free[:, -MARGIN_PX:] = False
        if free.mean() < LEAST_FREE:
            return ()
        moved = self._moved(evidence)
        if moved:
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
        size = max(1, width // PATTERN_PX), max(1, height // PATTERN_PX)
        ratio = (evidence.image + 1) / (evidence.lit + 1) - 1
        blocks = cv2.resize(ratio, size, interpolation=cv2.INTER_AREA)
        free = cv2.resize(evidence.touched.astype(np.float32), size, interpolation=cv2.INTER_AREA) < 0.5
        off = float(np.median(np.abs(blocks[free]).max(axis=-1))) if free.any() else 0.0
        if off < PATTERN:
            return ()
        said = (
            f"Half of the gel at rest differs by {100 * off:.1f} % or more from the start in any smooth light"
        )
        return (_other_gel(said, off),)

    def _other_texture(
        self, now: NDArray[np.float32], before: NDArray[np.float32] | None, free: NDArray[np.bool_]
    ) -> tuple[Finding, ...]:
        """Texture that repeats from one evidence to the next, but differs from the start's."""
        if before is None:
            return ()
        stays = _correlation(now[free], before[free])
        expected = stays * float(np.std(now[free])) / max(float(np.std(self._start[free])), 1e-9)
        found = _correlation(now[free], self._start[free])
        if expected < LEAST_EXPECTED or found > min(SAME_FRACTION * expected, SAME_GEL):
            return ()
        said = f"The fine texture correlates with the calibration's by {found:.2f}, expected {min(expected, 1.0):.2f}"
        return (_other_gel(said, found),)


def _other_gel(said: str, figure: float) -> Finding:
    return Finding(
        "other_gel", f"{said}. The gel or the sensor is not the calibrated one. Calibrate this one.", figure
    )


def _texture(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Detail finer than 2 px and coarser than noise, (H, W): relative brightness, channels combined."""
    logs = np.log(image.mean(axis=-1) + 10)
    fine = cv2.GaussianBlur(logs, (0, 0), FINE_PX) - cv2.GaussianBlur(logs, (0, 0), COARSE_PX)
    fine -= cv2.GaussianBlur(fine, (0, 0), 2 * COARSE_PX)  # curved shading is no texture
    limit = 6 * float(robust_sigma(fine))
    # Limit a single speck of dust.
    return np.asarray(np.clip(fine, -limit, limit), dtype=np.float32)


def _correlation(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt(np.dot(a, a) * np.dot(b, b)))
    return float(np.dot(a, b)) / size if size > 0 else 0.0
