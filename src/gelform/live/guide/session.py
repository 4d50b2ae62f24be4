"""A guided calibration on a station: its frames, presses of the simulated sensor, the fit in a thread, and its files."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from gelform.calibration.fit import calibrate
from gelform.calibration.library.library import add_calibration
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.report.content import report_content, report_coverage
from gelform.calibration.report.page import report_page
from gelform.calibration_file import Calibration
from gelform.errors import GelformError
from gelform.exchange.exporters.press_folder import save_press_folder
from gelform.foundations.npz_files import written_file
from gelform.foundations.progress import Progress
from gelform.live.guide.guide import Asked, Guide
from gelform.live.recorder import named_by_time
from gelform.live.shown import Shown
from gelform.live.station import Station

DEPTH_RATIO = 0.9  # of simulated presses: depth over radius x fraction^2 (0.5 for a spherical cap)
RIM_FRACTIONS = (0.45, 0.6, 0.52)  # contact radius over ball radius of successive simulated presses
GAP_S = 0.5  # s between simulated presses
HELD_S = 20.0  # s, longest simulated press; it is lifted once accepted, which takes long on a slow machine


class GuideSession:
    """One guided calibration on one station.

    Parameters
    ----------
    station : gives the frames
    asked : Asked
    folder : parent of the new folder for presses, calibration and report
    on_changed : called when the page has something new to show
    """

    def __init__(self, station: Station, asked: Asked, folder: Path, on_changed: Any) -> None:
        self.guide = Guide(asked, on_changed)
        self.name, self.kept = "", ""
        self.calibration: Calibration | None = None
        self._in_library: Path | None = None
        self._station, self._folder, self._on_changed = station, folder, on_changed
        self._pressed_s, self._pressed = 0.0, -1
        source: Any = station.source
        self._simulated = source if hasattr(source, "press_at") else None
        if self._simulated is not None:
            self._simulated.rest()
        station.taps.append(self._tap)

    def close(self) -> None:
        """Stop receiving frames; the simulated sensor continues its program."""
        if self._tap in self._station.taps:
            self._station.taps.remove(self._tap)
        if self._simulated is not None:
            self._simulated.rest(False)

    def fit(self, progress: Progress) -> None:
        """Calibrate on the accepted presses, write the files, and report the quality.

        Raises
        ------
        GelformError
            There are too few presses, or they do not fit; the guide continues to ask for presses.
        """
        guide, before = self.guide, self.guide.step
        guide.step, guide.hint = "fit", "gelform calibrates. This takes a moment."
        try:
            presses = guide.presses()
            calibration = calibrate(presses, progress=progress)
            content = report_content(presses, calibration, rng=np.random.default_rng(0))
            self.name = self._written(presses, calibration, content)
        except GelformError as problem:
            guide.step, guide.hint = before, f"The fit failed. {problem}"
            raise
        self._keep(calibration)
        self.calibration = calibration
        guide.report = report_facts(calibration, content, self.name)
        if calibration.report is not None:
            guide.covered = report_coverage(
                calibration.report, calibration.image_shape, calibration.known_mm_per_px
            )
        guide.step, guide.hint = "report", "Done. Read the report, then use the calibration."
        self._on_changed()

    def _keep(self, calibration: Calibration) -> None:
        """Add the calibration to the library; if that fails, it still is in the folder."""
        try:
            self._in_library, _ = add_calibration(calibration)
            self.kept = "The library has it too, so this sensor uses it from now on."
        except GelformError as problem:
            self.kept = f"The library does not have it: {problem} Name it with -c."

    def _tap(self, shown: Shown) -> None:
        self.guide.look_at(shown.frame)
        if self.guide.step == "press":
            self._press_simulated()

    def _press_simulated(self) -> None:
        """Press the simulated sensor at the suggested place, once for each target."""
        guide, target, now = self.guide, self.guide.target, time.monotonic()
        waiting = now - self._pressed_s < HELD_S and self._pressed == guide.count
        if self._simulated is None or target is None or waiting or guide.facts()["enough"]:
            return
        if self._pressed != guide.count:
            self._pressed, self._pressed_s = guide.count, now - HELD_S + GAP_S
            self._simulated.lift()
            return
        self._pressed_s = now
        radius = guide.asked.ball_diameter_mm / 2
        fraction = RIM_FRACTIONS[guide.count % len(RIM_FRACTIONS)]
        depth = DEPTH_RATIO * radius * fraction**2 + 0.05
        self._simulated.press_at(target.x_px, target.y_px, depth, ball_diameter_mm=2 * radius, held_s=HELD_S)

    def _written(self, presses: Presses, calibration: Calibration, content: dict[str, Any]) -> str:
        """Write the press folder, with the calibration and the report in it; return the folder's name."""
        folder = self._folder / named_by_time("calibration")
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
        return folder.name

    @property
    def path(self) -> Path:
        """The path of the calibration: in the library, else in the folder."""
        return self._in_library or self._folder / self.name / "calibration.npz"


def report_facts(calibration: Calibration, content: dict[str, Any], name: str) -> dict[str, Any]:
    """The parts of a report that the page shows; the full report is a file."""
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
