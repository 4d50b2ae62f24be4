"""Read presses with known loads: `loads.csv`, its images, and a log of the gauge if the loads are there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.presses.press_set import file_of, number, table_rows
from gelform.calibration_file import Calibration, as_calibration
from gelform.depth.force.fit import LEAST_RANGE, LEAST_SHARE, Load
from gelform.depth.force.model import why_no_normal
from gelform.depth.force.touch import Touch, touch_from_result
from gelform.errors import DataError
from gelform.foundations.checks import check_path
from gelform.foundations.progress import Progress, no_progress
from gelform.image.view import image_from_frame
from gelform.reconstruct import Reconstructor
from gelform.sensors.files import background_in, read_background, read_image

TABLE, LOG, REST = "loads.csv", "log.csv", "rest.png"
COLUMNS = ("force_n", "force_x_n", "force_y_n", "torque_n_mm")
LAGS = range(-3, 9)  # frames, that the gauge may lag behind the images
LEAST_FRAMES = 5  # of a sequence that tells its lag


@dataclass(frozen=True)
class LoadedPresses:
    """Presses with known loads.

    Attributes
    ----------
    touches : of the presses
    loads : of the same presses
    names : of their images
    lag_frames : that the gauge lags behind the images, already removed; None if no sequence tells it
    """

    touches: tuple[Touch, ...]
    loads: tuple[Load, ...]
    names: tuple[str, ...]
    lag_frames: int | None


@dataclass(frozen=True)
class _Sequence:
    """Images and a gauge's log of one grasp: row numbers, times of images and log in frames, and the log (T, 4)."""

    rows: NDArray[np.int64]
    times: NDArray[np.float64]
    log_times: NDArray[np.float64]
    log: NDArray[np.float64]

    def loads(self, lag: int) -> NDArray[np.float64]:
        """The loads (n, 4) at the images, read so many frames later; NaN where the log has none within a frame."""
        at = self.times + lag
        nearest = np.abs(at[:, None] - self.log_times).min(axis=1)
        there = (nearest <= 1) & (at >= self.log_times[0]) & (at <= self.log_times[-1])
        columns = [np.interp(at, self.log_times, column) for column in self.log.T]
        return np.where(there[:, None], np.stack(columns, axis=1), np.nan)


def read_loads(
    path: str | PathLike[str],
    calibration: Calibration | str | PathLike[str],
    *,
    background: str | PathLike[str] | None = None,
    progress: Progress = no_progress,
) -> LoadedPresses:
    """Read presses with known loads, and reconstruct their images.

    Parameters
    ----------
    path : a folder with `loads.csv`: the columns `image`, `object` and `force_n`, or `force_x_n` and `force_y_n`, or
        both, and optionally `torque_n_mm`. Rows of a film also have `grasp` and `frame`, or `time_s`, whose loads may
        be in `log.csv` (`time_s`, `force_n`): then the gauge's lag is estimated and removed
    calibration : of the sensor, or its file
    background : the gel at rest; by default `rest.png` beside an image, else the folder's `background.png`, else the
        calibration's own
    progress : called with (done, total, what)

    Raises
    ------
    DataError
        A file, a column or a number is missing or wrong, or an image is of another size.
    CalibrationError
        The images are not of the calibrated sensor.
    """
    folder, calibration = check_path(path), as_calibration(calibration)
    rest = None if background is None else check_path(background, "background as a path")
    rows = list(table_rows(folder / TABLE, ("image", "object")))
    if not rows:
        raise DataError(f"Expected a row for each press in {folder / TABLE}, got none.")
    sequences = list(_sequences(folder, rows))
    touches = []
    for touch in _touches(folder, [row["image"] for _, row in rows], calibration, rest):
        touches.append(touch)
        progress(len(touches), len(rows), "reconstructing presses")
    lag = _lag(sequences, touches)
    known = np.array([_loads_of_row(where, row) for where, row in rows])
    for sequence in sequences:
        known[sequence.rows] = sequence.loads(lag or 0)
    kept = [i for i, load in enumerate(known) if np.isfinite(load).any()]
    if not kept:
        raise DataError(
            f"Expected loads in {folder / TABLE} or {folder / LOG}: a column force_n, or force_x_n and force_y_n."
        )
    loads = (_load(rows[i][1]["object"], *known[i].tolist()) for i in kept)
    return LoadedPresses(
        tuple(touches[i] for i in kept), tuple(loads), tuple(rows[i][1]["image"] for i in kept), lag
    )


def _touches(
    folder: Path, images: list[str], calibration: Calibration, given: Path | None
) -> Iterator[Touch]:
    """The touch of each image; a Reconstructor lives as long as its background follows itself."""
    shared = given
    if shared is None and any(entry.stem == "background" for entry in folder.iterdir()):
        shared = background_in(folder)
    prepared: tuple[Path | None, Reconstructor] | None = None
    for name in images:
        image = folder / file_of(folder, name)
        own = image.parent / REST
        rest = own if given is None and own.is_file() else shared
        try:
            if prepared is None or prepared[0] != rest:
                prepared = rest, _reconstructor(calibration, rest)
            yield touch_from_result(prepared[1](read_image(image, most_pixels=calibration.most_pixels)))
        except ValueError as problem:
            raise DataError(f"{image}: {problem}") from problem


def _reconstructor(calibration: Calibration, rest: Path | None) -> Reconstructor:
    background = None if rest is None else image_from_frame(read_background(rest), calibration.view)
    return Reconstructor(calibration, background)


def _loads_of_row(where: str, row: Mapping[str, str]) -> list[float]:
    return [number(row[name], name, where) if row.get(name) else np.nan for name in COLUMNS]


def _load(name: str, normal: float, x: float, y: float, torsion: float) -> Load:
    sideways = (x, y) if np.isfinite([x, y]).all() else None
    return Load(name, _known(normal), sideways, _known(torsion))


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _sequences(folder: Path, rows: list[tuple[str, dict[str, str]]]) -> Iterator[_Sequence]:
    """The films among the rows: by `time_s` with a log, else by object, `grasp` and `frame`."""
    if (folder / LOG).is_file():
        log = list(table_rows(folder / LOG, ("time_s", "force_n")))
        log_times = np.array([number(row["time_s"], "time_s", where) for where, row in log])
        times = np.array([number(row.get("time_s", ""), "time_s", where) for where, row in rows])
        if len(log) < 2 or len(times) < 2 or (np.diff(log_times) <= 0).any() or not np.ptp(times) > 0:
            raise DataError(f"Expected rising times in {folder / LOG}, and images at several times.")
        frame_s = float(np.median(np.diff(np.unique(times))))
        loads = np.array([_loads_of_row(where, row) for where, row in log])
        yield _Sequence(np.arange(len(rows)), times / frame_s, log_times / frame_s, loads)
        return
    films: dict[tuple[str, str], list[int]] = {}
    for i, (_, row) in enumerate(rows):
        if row.get("grasp") and row.get("frame"):
            films.setdefault((row["object"], row["grasp"]), []).append(i)
    for film in films.values():
        frames = np.array([number(rows[i][1]["frame"], "frame", rows[i][0]) for i in film])
        order, own = np.argsort(frames, kind="stable"), np.array(film)
        loads = np.array([_loads_of_row(*rows[i]) for i in own[order]])
        yield _Sequence(own[order], frames[order], frames[order], loads)


def _lag(sequences: list[_Sequence], touches: list[Touch]) -> int | None:
    """The lag at which force over volume is steadiest within the films; None if no film has changing loads."""
    volume = np.array([0.0 if why_no_normal(touch) else float(touch.volume_mm3 or 0) for touch in touches])
    scatter = {
        lag: [_scatter(film.loads(lag)[:, 0], volume[film.rows]) for film in sequences] for lag in LAGS
    }
    told = [k for k in range(len(sequences)) if all(np.isfinite(scatter[lag][k]) for lag in LAGS)]
    if not told:
        return None
    return min(LAGS, key=lambda lag: float(np.mean([scatter[lag][k] for k in told])))


def _scatter(force: NDArray[np.float64], volume: NDArray[np.float64]) -> float:
    """Median distance of log F - log V from its median; NaN for few frames, or still ones."""
    there = np.isfinite(force) & (volume > 0)
    there &= force >= LEAST_SHARE * np.max(force[there], initial=0)
    there &= force > 0
    if np.count_nonzero(there) < LEAST_FRAMES or force[there].max() < LEAST_RANGE * force[there].min():
        return float("nan")
    ratio = np.log(force[there]) - np.log(volume[there])
    return float(np.median(np.abs(ratio - np.median(ratio))))
