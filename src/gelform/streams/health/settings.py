"""A camera that is set otherwise than it was calibrated with."""

from __future__ import annotations

from typing import Any

from gelform.background.check import Finding
from gelform.calibration_file import Calibration
from gelform.sensors import settings_mismatch


def settings_findings(calibration: Calibration, used: dict[str, Any]) -> tuple[Finding, ...]:
    """`settings_mismatch` of a source's settings, as they were read back; figure: how many are not as calibrated."""
    different = settings_mismatch(calibration.settings.get("camera", {}), used)
    if not different:
        return ()
    said = ", ".join(f"{name} {now} instead of {then}" for name, (then, now) in different.items())
    message = f"The camera is set otherwise than when it was calibrated: {said}. Set it as then, or calibrate again."
    return (Finding("settings_mismatch", message, float(len(different))),)
