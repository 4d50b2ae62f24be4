"""A camera that is another one than the calibration's, or set otherwise."""

from __future__ import annotations

from typing import Any

from gelform.calibration_file import Calibration
from gelform.findings import Finding
from gelform.sensors import settings_mismatch


class CameraCheck:
    """Compares a camera with the calibration's; again whenever it says something else: one that was unplugged forgets."""

    def __init__(self, calibration: Calibration) -> None:
        self._serial = calibration.serial
        self._settings = calibration.settings.camera or {}
        self._seen: tuple[str | None, dict[str, Any]] | None = None
        self._findings: tuple[Finding, ...] = ()

    def __call__(self, serial: str | None, settings: dict[str, Any]) -> tuple[Finding, ...]:
        """`other_camera` and `settings_mismatch`; figures: 1, and how many settings are not as calibrated.

        Parameters
        ----------
        serial, settings : of the source, as they were read back; what is not known is not compared
        """
        if self._seen != (serial, settings):
            self._seen = serial, settings
            self._findings = (*self._of_serial(serial), *self._of_settings(settings))
        return self._findings

    def _of_serial(self, serial: str | None) -> tuple[Finding, ...]:
        if not serial or not self._serial or serial == self._serial:
            return ()
        message = (
            f"The camera's serial is {serial}, the calibration is of {self._serial}. Colours differ from unit to unit: take "
            "that unit's calibration, or calibrate this one."
        )
        return (Finding("other_camera", message, 1.0),)

    def _of_settings(self, settings: dict[str, Any]) -> tuple[Finding, ...]:
        different = settings_mismatch(self._settings, settings)
        if not different:
            return ()
        said = ", ".join(f"{name} {now} instead of {then}" for name, (then, now) in different.items())
        message = f"The camera is set otherwise than when it was calibrated: {said}. Set it as then, or calibrate again."
        return (Finding("settings_mismatch", message, float(len(different))),)
