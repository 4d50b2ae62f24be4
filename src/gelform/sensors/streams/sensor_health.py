"""Faults of a sensor that only a sequence of frames shows: named findings with figures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration_file import Calibration
from gelform.foundations.findings import Finding
from gelform.image.background.check import room_light_finding
from gelform.image.background.light import block_means, light_from_blocks
from gelform.sensors import settings_mismatch
from gelform.sensors.grabber import Grabber
from gelform.sensors.source import Source
from gelform.sensors.streams.background_drift import DriftEvidence
from gelform.sensors.streams.marks import Marks
from gelform.sensors.streams.same_gel import SameGel

FROZEN = "frozen"
FROZEN_S, FROZEN_FRAMES = 0.25, 3  # s and frames: videos repeat some frames; noise makes all others differ
ROWS_APART = 16  # px between the rows of a first check for equal images
BRIGHTER = 0.08  # log of the gain of all channels: slopes stay good, but something changed
COLORED = 0.03  # log of one channel's gain relative to the others


class CameraCheck:
    """Compares a camera with the calibration's, again after each change of its facts.

    A reconnected camera loses settings.
    """

    def __init__(self, calibration: Calibration) -> None:
        self._serial = calibration.serial
        self._settings = calibration.settings.camera or {}
        self._compared: tuple[str | None, dict[str, Any]] | None = None
        self._findings: tuple[Finding, ...] = ()

    def __call__(self, camera: Source | Grabber) -> tuple[Finding, ...]:
        """Find `other_camera` and `settings_mismatch`.

        Their figures are 1, and the number of settings that differ from the calibration.

        Parameters
        ----------
        camera : its serial number and settings, as read back; unknown ones are not compared
        """
        now = camera.serial, dict(camera.settings)
        if self._compared != now:
            self._compared, self._findings = now, tuple(self._differences(*now))
        return self._findings

    def _differences(self, serial: str | None, settings: dict[str, Any]) -> Iterator[Finding]:
        if serial and self._serial and serial != self._serial:
            message = (
                f"The camera's serial is {serial}, but the calibration is of {self._serial}. Colors differ from unit to "
                "unit. Use this unit's calibration, or calibrate it."
            )
            yield Finding("other_camera", message, 1.0)
        different = settings_mismatch(self._settings, settings)
        if different:
            said = ", ".join(f"{name} {now} instead of {then}" for name, (then, now) in different.items())
            message = f"The camera's settings differ from those at calibration: {said}. Restore them, or calibrate again."
            yield Finding("settings_mismatch", message, float(len(different)))


class Frozen:
    """Counts for how long the images of a sequence have been equal, pixel by pixel."""

    def __init__(self) -> None:
        self._last: NDArray[Any] | None = None
        self._since_s = 0.0
        self._count = 0

    def __call__(self, image: NDArray[Any], time_s: float) -> tuple[Finding, ...]:
        """The finding `frozen` (figure: duration, s), from the third equal image and 0.25 s on."""
        if self._last is None or not _equal(image, self._last) or time_s < self._since_s:
            self._last, self._since_s, self._count = image, time_s, 1
            return ()
        self._count += 1
        for_s = time_s - self._since_s
        if self._count < FROZEN_FRAMES or for_s < FROZEN_S:
            return ()
        message = f"The camera hangs: it has given the same image for {for_s:.1f} s. The depth is that of this image."
        return (Finding(FROZEN, message, for_s),)


def _equal(image: NDArray[Any], other: NDArray[Any]) -> bool:
    if image.shape != other.shape or not np.array_equal(image[::ROWS_APART], other[::ROWS_APART]):
        return False
    return np.array_equal(image, other)


def light_findings(gains: NDArray[np.float64]) -> tuple[Finding, ...]:
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
