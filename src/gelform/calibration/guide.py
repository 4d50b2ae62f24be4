"""Presses of a ball under guidance: what an image shows, the next place, the folder of accepted presses, the calibration."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.calibration.circles.find import (
    BLUR_PX,
    USUAL_OFFSET,
    ColorChanges,
    ContactCircle,
    PreparedPress,
    about_median,
    find_contact,
    magnitude,
    scale_of,
    why_no_contact,
    with_contacts,
)
from gelform.calibration.coverage import NEEDED, Coverage, PressPlace, press_coverage, press_next
from gelform.calibration.fit import calibrate
from gelform.calibration.library import add_calibration
from gelform.calibration.presses.press_set import (
    Circle,
    Press,
    Presses,
    check_ball_diameter,
    presses_from_settings,
)
from gelform.calibration.report.content import COVERED, level_of, report_content, report_coverage
from gelform.calibration.report.page import report_page
from gelform.calibration.starters import starter_for, starter_names
from gelform.calibration_file import Calibration
from gelform.errors import CalibrationError, DataError, Finding, GelformError, Progress, cannot, no_progress
from gelform.exchange.exporters.press_folder import save_press_folder, toml_of_settings
from gelform.foundations.checks import check_sensor_pitch
from gelform.foundations.files import made_folder, picture_bytes, written_file
from gelform.image.background import (
    USUAL_FRAMES,
    Background,
    ChangeSettings,
    background_from_frames,
    surround_finding,
)
from gelform.image.view import Frame, View, image_from_frame
from gelform.sensors.files import SensorSettings
from gelform.sensors.grabber import Grabber
from gelform.sensors.profiles import check_gel_width, make_of, profile_named
from gelform.sensors.record import named_by_time
from gelform.sensors.simulated import SimulatedSource
from gelform.sensors.source import Source

TOUCHED = 0.002  # fraction of the pixels that the lightest touch changes


class TakenPresses:
    """Writes a press folder image by image, so that a later failure loses no image.

    DataError: the folder is not empty, or cannot be written.
    """

    def __init__(self, folder: Path, settings: SensorSettings, ball_diameter_mm: float) -> None:
        self.folder, self.ball_diameter_mm = folder, ball_diameter_mm
        self._view, self._make = settings.view, settings.make
        self.count = 0
        self._rest: NDArray[np.float32] | None = None
        self._limit: NDArray[np.float64] | None = None  # gray levels, least difference of a touched pixel
        with cannot(f"write {folder}"):
            if any(made_folder(folder).iterdir()):
                raise DataError(f"Expected a new or empty folder, got {folder}. Choose another name.")
            (folder / "images").mkdir()
        self._write("sensor.toml", toml_of_settings(settings).encode())
        self._write_table()

    def take_background(self, frames: Sequence[NDArray[np.uint8]]) -> Background:
        """Keep frames (H, W, 3) uint8 RGB of the gel at rest; what is doubted of them, and a DataError if they disagree."""
        average = _at_rest([image_from_frame(one, self._view) for one in frames], self._make)
        self._rest = average.background
        self._limit = np.maximum(6.0 * np.asarray(average.noise), 4.0)
        (self.folder / "background").mkdir(exist_ok=True)
        for k, frame in enumerate(frames):
            self._write(f"background/{k:02d}.png", picture_bytes(frame))
        return average

    def take_press(self, image: NDArray[np.uint8]) -> str:
        """Keep an image (H, W, 3) uint8 RGB of a press, and return its name in the folder.

        DataError: nothing is pressed.
        """
        if self._rest is None:
            raise DataError("Expected the background before the presses.")
        change = np.abs(image_from_frame(image, self._view) - self._rest)
        if (change > self._limit).any(axis=-1).mean() < TOUCHED:
            raise DataError("Nothing is pressed: the image shows the gel at rest.")
        name = f"images/{self.count:04d}.png"
        self._write(name, picture_bytes(image))
        self.count += 1
        self._write_table()
        return name

    def drop_last(self) -> str | None:
        """Remove the last press; return its name, or None without one."""
        if self.count == 0:
            return None
        self.count -= 1
        self._write_table()
        name = f"images/{self.count:04d}.png"
        (self.folder / name).unlink()
        return name

    def _write_table(self) -> None:
        rows = "".join(f"images/{k:04d}.png,{self.ball_diameter_mm:.6g}\n" for k in range(self.count))
        self._write("presses.csv", f"image,ball_diameter_mm\n{rows}".encode())

    def _write(self, name: str, content: bytes) -> None:
        """Write a file so that it is complete, or the previous one."""
        with written_file(self.folder / name, overwrite=True) as handle:
            handle.write(content)


def _at_rest(images: Sequence[NDArray[np.uint8]], make: str) -> Background:
    """The background of images (H, W, 3) of a make, whose light is known to be smooth if it has a starter."""
    return background_from_frames(images, smooth=starter_for(make, images[0].shape[:2]) is not None)


def settings_of(
    source: Source | Grabber,
    frame_shape: tuple[int, int],
    make: str | None = None,
    mm_per_px: float | None = None,
) -> SensorSettings:
    """What is known of a source's sensor: the make's scale, gel and view of frames (H, W); its serial number and settings.

    A given scale takes the place of the make's; one of them is needed. ValueError: the make is unknown.
    """
    view, sigma, name, thickness_mm = View(), None, source.name, None
    if make is not None:
        profile = profile_named(make)
        view, name, thickness_mm = profile.view(frame_shape), profile.name, profile.gel_thickness_mm
        if mm_per_px is None:
            mm_per_px, sigma = profile.mm_per_px, profile.mm_per_px_sigma
    assert mm_per_px is not None
    return SensorSettings(
        name,
        mm_per_px,
        sigma,
        make=make or "",
        serial=source.serial or "",
        gel_thickness_mm=thickness_mm,
        view=view,
        camera=dict(source.settings),
    )


SMALL = 8  # px, width of the blocks that are compared for motion
LEAST = NEEDED.guided.presses
LOOK_EVERY_S = 0.08  # s between analyzed frames; an analysis takes some 10 ms
STILL_LOOKS = 3  # consecutive still frames until a press counts
NEXT_PLACES = 3  # suggested places on the page: the next one, and those after it


@dataclass(frozen=True)
class JudgedImage:
    """The content of an image."""

    circle: Circle | None  # the contact (x, y, radius), px
    touched: bool  # whether anything touches the gel
    moving: bool  # whether it differs from the previous image
    reason: str  # why this press is not accepted; "" if it is
    marked: bool = False  # whether the circle's center is the one that was clicked


class Judge:
    """Analyzes the images of one sensor in sequence."""

    def __init__(
        self,
        background: NDArray[np.float32],  # (H, W, 3)
        untouched: NDArray[np.uint8],  # (H, W, 3), a frame at rest, with the colors' change by noise
        noise: float,  # standard deviation of a pixel in one frame, gray levels
        ball_radius_px: float,
    ) -> None:
        self._shape = background.shape[:2]
        self._scale = scale_of((self._shape[0], self._shape[1]))
        settings = ChangeSettings("divide", USUAL_OFFSET, BLUR_PX * self._scale)
        self._changes = ColorChanges(background, settings)
        self._still = 1.0 + 0.9 * noise  # gray levels, largest change of a still block
        self._ball_px = ball_radius_px
        self._before: NDArray[np.float32] | None = None
        self._background = background
        self._looked: PreparedPress | None = None  # the last image in which a ball was sought
        self._accepted: deque[PreparedPress] = deque(maxlen=8)
        self._touched = max(0.05, 1.6 * _largest(self._changes(untouched)[0]))  # color change

    def look(
        self,
        image: NDArray[Any],
        accepted: Sequence[Circle] = (),
        clicked: tuple[float, float] | None = None,
        *,
        by_templates: bool = True,
    ) -> JudgedImage:
        """Judge an image (H, W, 3), given the accepted presses, and the center (x, y) that was clicked or None.

        A ball whose colors are hardly odd is sought by templates too, which takes longer.
        """
        height, width = self._shape
        small = cv2.resize(image, (width // SMALL, height // SMALL), interpolation=cv2.INTER_AREA)
        before, self._before = self._before, small.astype(np.float32)
        moving = before is None or float(np.abs(self._before - before).max()) > self._still
        try:
            change, usable = self._changes(image)
        except CalibrationError as refusal:
            return JudgedImage(None, True, moving, str(refusal))
        if _largest(change) < self._touched:
            return JudgedImage(None, False, moving, "")
        contact = find_contact(change)
        if clicked is not None or by_templates:  # what the presses so far show elsewhere too is no ball
            mark, size = None if clicked is None else (*clicked, None), magnitude(about_median(change))
            known = "", change, size, self._ball_px, contact, usable, self._background
            self._looked = with_contacts([*self._accepted, PreparedPress(*known, mark=mark)])[-1]
            contact = self._looked.found
        if why_no_contact(contact) is None:
            return JudgedImage(
                contact.circle_px, True, moving, self._reason(contact, accepted), contact.marked
            )
        reason = "No ball is clearly visible. Press it a little harder, straight down. Or click the middle of its imprint."
        return JudgedImage(None, True, moving, reason)

    def accept(self) -> None:
        """Take the last image as a press of the set, with which balls in later images are sought."""
        if self._looked is not None:
            self._accepted.append(self._looked)

    def _reason(self, contact: ContactCircle, accepted: Sequence[Circle]) -> str:
        x, y, radius = contact.circle_px
        height, width = self._shape
        beyond = 0.2 * radius  # the border
        if not (-beyond < x < width + beyond and -beyond < y < height + beyond):
            return "The press is too far outside. Press at the circle."
        if radius < 9.0 * self._scale:  # px at 240 rows
            return "The press is too light. Press a little harder."
        if radius > np.sqrt(3) / 2 * self._ball_px:  # pressed in by half the radius
            return "The press is too deep, or the ball has another size. Press at most half the ball's radius deep."
        if any(np.hypot(x - ax, y - ay) < 0.4 * max(radius, ar) for ax, ay, ar in accepted):
            return "You pressed here before. Press at the circle."
        return ""


def _largest(change: NDArray[np.float32]) -> float:
    """The size that a touch's fewest pixels exceed."""
    size = np.abs(change).max(axis=-1)
    rank = size.size - int(TOUCHED * size.size) - 1
    return float(np.partition(size, rank, axis=None)[rank])


@dataclass(frozen=True, eq=False)
class GuidedCalibration:
    """A calibration of guided presses."""

    calibration: Calibration
    folder: Path  # has the presses, calibration.npz and report.html
    report: dict[str, Any]  # the figures that the live page shows; the full report is a file
    covered: Coverage  # of the presses that it was fitted on
    places: tuple[PressPlace, ...]  # the next ones to press, which the report marks 1, 2, 3

    @property
    def report_file(self) -> Path:
        """The report's page."""
        return self.folder / "report.html"

    def keep(self) -> tuple[Path, str]:
        """Add it to the library; return its path, and a sentence. If that fails, it still is in the folder."""
        try:
            path, _ = add_calibration(self.calibration)
        except GelformError as problem:
            said = f"The library does not have it: {problem} Name it with -c."
            return self.folder / "calibration.npz", said
        return path, "The library has it too, so this sensor uses it from now on."


def calibrate_guided(
    presses: Presses, folder: Path, *, progress: Progress = no_progress
) -> GuidedCalibration:
    """Calibrate on presses, and write them with the calibration and its report to a new folder.

    The new folder is below `folder`, and is named by the time. GelformError: the presses do not fit, or the folder cannot be
    written.
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
        settings=SensorSettings(
            presses.sensor_name,
            presses.mm_per_px,
            presses.mm_per_px_sigma,
            serial=presses.serial or "",
            make=presses.make or "",
            gel_thickness_mm=presses.geometry.gel_thickness_mm,
            camera=presses.camera,
        ),
    )
    calibration.save(folder / "calibration.npz")
    with written_file(folder / "report.html") as handle:
        handle.write(report_page(content, presses, calibration).encode())
    covered = report_coverage(calibration.report, calibration.image_shape, calibration.known_mm_per_px)
    places = tuple(PressPlace(one["name"], one["x_px"], one["y_px"]) for one in content["coverage"]["next"])
    rows = calibration.report.presses
    facts = {
        "folder": folder.name,
        **{key: content["verdict"][key] for key in ("level", "headline", "next")},
        "checks": [
            {key: check[key] for key in ("label", "unit", "value", "level")} for check in content["checks"]
        ],
        "model": calibration.color_model.name,
        "accepted": sum(row.accepted for row in rows),
        "rejected": [[row.name, row.reason] for row in rows if row.reason and not row.repeats],
    }
    return GuidedCalibration(calibration, folder, facts, covered, places)


class Guide:
    """One guided calibration of a sensor, from the background to the files.

    `settings` are of the sensor, as far as they are known; `on_changed` is called when the page has something new to show.
    """

    def __init__(
        self, settings: SensorSettings, ball_diameter_mm: float, on_changed: Callable[[], None] = lambda: None
    ) -> None:
        self.settings, self.ball_diameter_mm = settings, ball_diameter_mm
        self.step = "background"  # or "press", "fit", "report", "failed"
        self.hint = "Touch nothing while the page takes the background."  # instruction for the user
        self.places: tuple[PressPlace, ...] = ()  # to press, chosen after each; the most helpful one first
        self.covered: Coverage | None = None  # of the accepted presses, None before the background exists
        # number of presses to fit well; `press_more` raises it
        needed = NEEDED.advised if settings.make not in starter_names() else NEEDED.started
        self.wanted = needed.presses
        self.made: GuidedCalibration | None = None  # the calibration and its files, None before the fit
        self._changed = on_changed
        self._lock = threading.Lock()
        self._shape: tuple[int, ...] | None = None  # (H, W) of its images, None before the first
        self._untouched: list[NDArray[np.uint8]] = []
        self._refusals = 0
        self._background: NDArray[np.float32] | None = None
        self._noise: NDArray[np.float64] | None = None
        self._surround: Finding | None = None
        self._judge: Judge | None = None
        self._presses: list[Press] = []
        self._circles: list[Circle] = []
        self._click: tuple[float, float] | None = None
        self._verdicts: list[tuple[Circle, str]] = []
        self._live: JudgedImage | None = None
        self._still = 0
        self._lifted = True
        self._looked_at = 0.0

    @classmethod
    def of(
        cls,
        source: Source,
        frame_shape: tuple[int, int],
        ball_diameter_mm: float,
        *,
        profile: str = "",
        mm_per_px: float = 0.0,
        begun: Calibration | None = None,
        on_changed: Callable[[], None] = lambda: None,
    ) -> Guide:
        """A guide for a source's sensor; the scale is the simulated sensor's, the profile's, or the given one.

        `frame_shape` is (H, W) of its frames, `mm_per_px` for a sensor without a profile. If the profile's starter made the
        calibration in use (`begun`), its scale and view are taken. GelformError: the ball or the scale is impossible.
        """
        try:
            diameter = check_ball_diameter(ball_diameter_mm)
            if isinstance(source, SimulatedSource):
                settings = SensorSettings(
                    source.sensor.name, source.sensor.mm_per_px, serial=source.serial or ""
                )
            elif begun is not None and begun.settings.starter and begun.settings.starter["sensor"] == profile:
                settings = replace(
                    settings_of(source, frame_shape, mm_per_px=begun.known_mm_per_px),
                    name=begun.sensor_name,
                    mm_per_px_sigma=begun.mm_per_px_sigma,
                    make=profile,
                    gel_thickness_mm=begun.settings.gel_thickness_mm,
                    view=begun.view,
                )
            elif profile:
                settings = settings_of(source, frame_shape, profile)
            else:
                check_gel_width(frame_shape, check_sensor_pitch(mm_per_px), make_of(source.name))
                settings = settings_of(source, frame_shape, mm_per_px=float(mm_per_px))
        except (ValueError, TypeError) as problem:
            raise GelformError(str(problem)) from problem
        return cls(settings, diameter, on_changed)

    @property
    def target(self) -> PressPlace | None:
        """The place for the next press; None if no place helps any more."""
        return self.places[0] if self.places else None

    @property
    def count(self) -> int:
        """Number of accepted presses."""
        return len(self._circles)

    @property
    def enough(self) -> bool:
        """Whether there are enough presses, and their coverage is not poor."""
        return self.count >= self.wanted and self._coverage_level != "poor"

    def look_at(self, frame: Frame) -> None:
        """Process a frame; frames too soon after the last one are skipped."""
        now = time.monotonic()
        if self.step not in ("background", "press") or now - self._looked_at < LOOK_EVERY_S:
            return
        self._looked_at = now
        try:
            image = np.ascontiguousarray(image_from_frame(frame.image, self.settings.view), dtype=np.uint8)
            if self._shape not in (None, image.shape[:2]):
                had, now_has = (f"{width}x{height}" for height, width in (self._shape, image.shape[:2]))
                raise GelformError(
                    f"Expected images of {had} px, as before, got {now_has} px. Set the camera back, or start again."
                )
        except GelformError as problem:
            self.hint = str(problem)
            self._changed()
            return
        self._shape = image.shape[:2]
        with self._lock:
            if self.step == "background":
                self._add_untouched(image)
            else:
                self._judge_press(image)
        self._changed()

    def presses(self) -> Presses:
        """The accepted presses, in the form that calibration reads; GelformError if there are too few."""
        with self._lock:
            if self._background is None or self.count < LEAST:
                raise GelformError(f"Expected at least {LEAST} presses, got {self.count}. Press again.")
            what = "guided presses", self._presses, self._background, self.settings.view
            return presses_from_settings(self.settings, *what, background_noise=self._noise)

    def fit(self, folder: Path, progress: Progress = no_progress) -> None:
        """Calibrate on the accepted presses, and write the files to a new folder below `folder`.

        GelformError: there are too few presses, or they do not fit; the guide continues to ask for presses.
        """
        before = self.step
        self.step, self.hint = "fit", "gelform calibrates. This takes a moment."
        try:
            self.made = calibrate_guided(self.presses(), folder, progress=progress)
        except GelformError as problem:
            self.step, self.hint = before, f"The fit failed. {problem}"
            raise
        self.covered, self.places = self.made.covered, self.made.places
        self.step, self.hint = "report", "Read the report. Then use the calibration, press more, or leave it."
        self._changed()

    def click(self, x_px: float, y_px: float) -> None:
        """Take a place of the image as the middle of the present press, where gelform does not see a ball."""
        with self._lock:
            self._click, self._still = (x_px, y_px), 0

    def press_more(self) -> None:
        """Ask for presses at the report's places, in addition to the accepted ones, and for another fit."""
        if self.made is None:
            raise GelformError("There is no report yet. Press Fit now first.")
        with self._lock:
            self.made, self.wanted = None, max(self.wanted, self.count + len(self.places))
            self.step, self.hint = "press", self._asking()
        self._changed()

    def facts(self) -> dict[str, Any]:
        """The guide's state for the page."""
        with self._lock:
            live, coverage = self._live, None
            radius = 0.55 * self._ball_radius_px  # of the target, before the first press
            if self._circles:
                radius = float(np.median([of_press for _, _, of_press in self._circles]))
            if self.covered is not None:
                directions = (self.covered.counts > 0).sum(axis=-1)  # of the eight, in each tile
                coverage = {
                    "tiles": list(directions.shape),
                    "directions": directions.ravel().tolist(),
                    "share": self.covered.fraction,
                    "level": self._coverage_level,
                    "wanted": COVERED.fair,
                }
            return {
                "step": self.step,
                "hint": self.hint,
                "count": self.count,
                "wanted": self.wanted,
                "enough": self.enough,
                "can_fit": self.count >= LEAST,
                "untouched": [len(self._untouched), USUAL_FRAMES],
                "places": [[place.x_px, place.y_px, radius, place.name] for place in self.places],
                "live": None if live is None or live.circle is None else list(live.circle),
                "still": self._still / STILL_LOOKS,
                "accepted": [list(circle) for circle in self._circles],
                "rejected": [[*circle, reason] for circle, reason in self._verdicts[-5:]],
                "coverage": coverage,
                "report": None if self.made is None else self.made.report,
            }

    # -- one image ----------------------------------------------------------------------------------------------------

    def _add_untouched(self, image: NDArray[np.uint8]) -> None:
        self._untouched.append(image)
        if len(self._untouched) < USUAL_FRAMES:
            return
        try:
            taken = _at_rest(self._untouched, self.settings.make)
        except GelformError as problem:
            doubt = str(problem)
        else:
            doubt = (
                taken.touch.message if taken.touch and self._refusals < 5 else ""
            )  # then the gel is damaged
            self._refusals += 1
        if doubt:
            self._untouched, self.hint = [], f"{doubt} Touch nothing: the page tries again."
            return
        self._background, self._noise = np.rint(taken.background).astype(np.float32), taken.noise
        self._surround = surround_finding(
            self._background,
            "--crop {} of gelform calibrate, with presses from gelform record --presses",
            viewed=not self.settings.view.is_identity,
        )
        self._judge = Judge(self._background, image, float(taken.noise.max()), self._ball_radius_px)
        self.step = "press"
        self._ask_next()

    def _judge_press(self, image: NDArray[np.uint8]) -> None:
        """Accept or reject a press that is held still."""
        assert self._judge is not None
        judged = self._lifted and self._still + 1 >= STILL_LOOKS
        look = self._live = self._judge.look(image, self._circles, self._click, by_templates=judged)
        if not look.touched:
            self._lifted, self._still, self._click = True, 0, None
            self.hint = self._asking()
        elif not self._lifted:
            self._still = 0
        elif look.moving:
            self._still = 0
            self.hint = "Hold still."
        elif self._still + 1 < STILL_LOOKS:
            self._still += 1
        else:
            self._still = 0
            if look.reason or look.circle is None:
                self.hint = look.reason
                if look.circle is not None and self._verdicts[-1:] != [(look.circle, look.reason)]:
                    self._verdicts.append((look.circle, look.reason))
                return
            name, click = f"images/{self.count:04d}.png", self._click if look.marked else None
            self._presses.append(Press(name, image, self.ball_diameter_mm, center_px=click))
            self._circles.append(look.circle)
            self._judge.accept()
            self._lifted = False
            self._ask_next()
            self.hint = "Accepted. Lift the ball."

    def _ask_next(self) -> None:
        assert self._background is not None
        shape = (self._background.shape[0], self._background.shape[1])
        self.covered = press_coverage(self._circles, [self._ball_radius_px] * self.count, shape)
        self.places = press_next(self.covered, NEXT_PLACES)
        self.hint = self._asking()

    def _asking(self) -> str:
        if self.enough:
            return "You can fit now. More presses show more of the gel: press at circle 1."
        asking = f"Press the ball at 1: {self.target.name}." if self.target else "Press at any other place."
        return asking if self._surround is None or self._circles else f"{self._surround.message} {asking}"

    @property
    def _coverage_level(self) -> str:
        return level_of(COVERED, None if self.covered is None else 100 * self.covered.fraction)

    @property
    def _ball_radius_px(self) -> float:
        return self.ball_diameter_mm / 2 / self.settings.square_mm_per_px
