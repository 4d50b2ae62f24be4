"""The calibration of guided presses, and its files: presses, calibration, report; in the library once it is wanted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gelform.calibration.coverage import Coverage, PressPlace
from gelform.calibration.fit import calibrate
from gelform.calibration.library.library import add_calibration
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.report.content import report_content, report_coverage
from gelform.calibration.report.page import report_page
from gelform.calibration_file import Calibration
from gelform.errors import GelformError
from gelform.exchange.exporters.press_folder import save_press_folder
from gelform.foundations.files import written_file
from gelform.foundations.findings import Progress, no_progress
from gelform.sensors.record import named_by_time


@dataclass(frozen=True, eq=False)
class GuidedCalibration:
    """A calibration of guided presses.

    Attributes
    ----------
    calibration : Calibration
    folder : has the presses, calibration.npz and report.html
    report : the figures that the live page shows; the full report is a file
    covered : the coverage of the presses that it was fitted on
    places : the next places to press, which the report marks 1, 2, 3
    """

    calibration: Calibration
    folder: Path
    report: dict[str, Any]
    covered: Coverage
    places: tuple[PressPlace, ...]

    @property
    def report_file(self) -> Path:
        """The report's page."""
        return self.folder / "report.html"

    def keep(self) -> tuple[Path, str]:
        """Add it to the library; return its path, and a sentence. If that fails, it still is in the folder."""
        try:
            path, _ = add_calibration(self.calibration)
        except GelformError as problem:
            return (
                self.folder / "calibration.npz",
                f"The library does not have it: {problem} Name it with -c.",
            )
        return path, "The library has it too, so this sensor uses it from now on."


def calibrate_guided(
    presses: Presses, folder: Path, *, progress: Progress = no_progress
) -> GuidedCalibration:
    """Calibrate on presses, and write them with the calibration and its report to a new folder.

    The new folder is below `folder`, and is named by the time.

    Raises
    ------
    GelformError
        The presses do not fit, or the folder cannot be written.
    """
    calibration = calibrate(presses, progress=progress)
    folder = folder / named_by_time("calibration")
    content = report_content(presses, calibration, rng=np.random.default_rng(0))
    save_press_folder(
        folder,
        background=presses.background,
        images=[press.image for press in presses.presses],
        ball_diameters_mm=[press.ball_diameter_mm for press in presses.presses],
        mm_per_px=presses.mm_per_px,
        name=presses.sensor_name,
        serial=presses.serial or "",
    )
    calibration.save(folder / "calibration.npz")
    with written_file(folder / "report.html") as handle:
        handle.write(report_page(content, presses, calibration).encode())
    covered = report_coverage(calibration.report, calibration.image_shape, calibration.known_mm_per_px)
    places = tuple(
        PressPlace(place["name"], place["x_px"], place["y_px"]) for place in content["coverage"]["next"]
    )
    return GuidedCalibration(
        calibration, folder, _report_facts(calibration, content, folder.name), covered, places
    )


def _report_facts(calibration: Calibration, content: dict[str, Any], name: str) -> dict[str, Any]:
    verdict = content["verdict"]
    shown = ("label", "unit", "value", "level")
    return {
        "folder": name,
        "level": verdict["level"],
        "headline": verdict["headline"],
        "next": verdict["next"],
        "checks": [{key: check[key] for key in shown} for check in content["checks"]],
        "model": calibration.color_model.name,
        "accepted": sum(row.accepted for row in calibration.report.presses),
        "rejected": [
            [row.name, row.reason] for row in calibration.report.presses if row.reason and not row.repeats
        ],
    }
