"""Read presses with known loads: `loads.csv`, its images, and a log of the gauge if the loads are there."""

from __future__ import annotations

from collections.abc import Iterator
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.presses.press_set import file_of, number, table_rows
from gelform.calibration_file import Calibration, as_calibration
from gelform.depth.force import (
    LEAST_RANGE,
    LEAST_SHARE,
    Load,
    Touch,
    touch_from_result,
    touches_in_order,
    why_no_normal,
)
from gelform.errors import DataError, Progress, no_progress
from gelform.foundations.checks import check_path
from gelform.image.view import image_from_frame
from gelform.reconstruct import Reconstructor
from gelform.sensors.files import background_in, read_background, read_image

COLUMNS = ("force_n", "force_x_n", "force_y_n", "torque_n_mm")
LAGS = range(-3, 9)  # frames, that the gauge may lag behind the images
Row = tuple[str, dict[str, str]]


class LoadedPresses(NamedTuple):
    """Presses with known loads, and the names of their images."""

    touches: list[Touch]
    loads: list[Load]
    names: list[str]
    # that the gauge lags behind the images, already removed; None if no film tells it, or each states its own
    lag_frames: int | None


class _Film(NamedTuple):
    """Rows of images at times, and the log (T, 4) of a gauge at its own times, both in frames."""

    rows: NDArray[np.int64]
    times: NDArray[np.float64]
    log_times: NDArray[np.float64]
    log: NDArray[np.float64]

    def loads(self, lag: int) -> NDArray[np.float64]:
        """The loads (n, 4) at the images, read so many frames later; NaN where the log has none within a frame."""
        at = self.times + lag
        nearest = np.abs(at[:, None] - self.log_times).min(axis=1)
        there = (nearest <= 1) & (at >= self.log_times[0]) & (at <= self.log_times[-1])
        read = np.stack([np.interp(at, self.log_times, column) for column in self.log.T], axis=1)
        return np.where(there[:, None], read, np.nan)


def read_loads(
    path: str | PathLike[str],
    calibration: Calibration | str | PathLike[str],
    *,
    background: str | PathLike[str] | None = None,
    lag_frames: int | None = None,
    bgr: bool = False,
    progress: Progress = no_progress,
) -> LoadedPresses:
    """Read presses with known loads, and reconstruct their images.

    Parameters
    ----------
    path : a folder with `loads.csv`: the columns `image`, `object` and `force_n`, or `force_x_n` and `force_y_n`, or
        both, and optionally `torque_n_mm`. Rows of a film also have `grasp` and `frame`, or `time_s`, whose loads are
        in `log.csv` (`time_s`, `force_n`). A recording's known lag is a column `lag_frames` of whole numbers
    calibration : of the sensor, or its file
    background : the gel at rest; by default `rest.png` beside an image, else the folder's `background.png`, else the
        calibration's own
    lag_frames : that the gauge lags behind the images, where the table does not state it, such as a force model's. By
        default it is estimated from the loads, which only a calibration may do
    bgr : whether all images, the background too, are blue, green, red
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
    rows = list(table_rows(folder / "loads.csv", ("image", "object")))
    known = np.array([_loads_of(row) for row in rows]).reshape(-1, len(COLUMNS))
    films = list(_films(folder, rows))
    touches = []
    for touch in _touches(folder, [row["image"] for _, row in rows], calibration, rest, bgr):
        touches.append(touch)
        progress(len(touches), len(rows), "reconstructing presses")
    stated = [_stated_lag(rows, film) for film in films]
    if lag_frames is None and None in stated:
        lag_frames = _lag([film for film, one in zip(films, stated) if one is None], touches)
    lags = [lag_frames if one is None else one for one in stated]
    lag = lags[0] if len(set(lags)) == 1 else None
    for film, own in zip(films, lags):
        known[film.rows] = film.loads(own or 0)
        order = film.rows[np.argsort(film.times)].tolist()
        for i, touch in zip(order, touches_in_order([touches[i] for i in order])):
            touches[i] = touch
    kept = np.flatnonzero(np.isfinite(known).any(axis=1))
    if not kept.size:
        raise DataError(
            f"Expected loads in {folder / 'loads.csv'}: a column force_n, or force_x_n and force_y_n."
        )
    loads = []
    for i in kept:
        normal, x, y, torsion = (one if np.isfinite(one) else None for one in known[i].tolist())
        shear = None if x is None or y is None else (x, y)
        loads.append(Load(rows[i][1]["object"], normal, shear, torsion, rows[i][1].get("grasp") or ""))
    return LoadedPresses([touches[i] for i in kept], loads, [rows[i][1]["image"] for i in kept], lag)


def _touches(
    folder: Path, images: list[str], calibration: Calibration, given: Path | None, bgr: bool
) -> Iterator[Touch]:
    """The touch of each image; a Reconstructor serves all images in a row with the same background."""
    shared = given
    if shared is None and any(entry.stem == "background" for entry in folder.iterdir()):
        shared = background_in(folder)
    reconstruct, before = None, None
    for name in images:
        image = folder / file_of(folder, name)
        own = image.parent / "rest.png"
        rest = own if given is None and own.is_file() else shared
        try:
            if reconstruct is None or rest != before:
                frame = None if rest is None else read_background(rest, bgr=bgr)
                today = None if frame is None else image_from_frame(frame, calibration.view)
                reconstruct, before = Reconstructor(calibration, today), rest
            frame = read_image(image, most_pixels=calibration.most_pixels, bgr=bgr)
            yield touch_from_result(reconstruct(frame))
        except ValueError as problem:
            raise DataError(f"{image}: {problem}") from problem


def _loads_of(row: Row) -> list[float]:
    where, cells = row
    return [number(cells[name], name, where) if cells.get(name) else np.nan for name in COLUMNS]


def _films(folder: Path, rows: list[Row]) -> Iterator[_Film]:
    """The films among the rows: one by `time_s` with a log, else by object, `grasp` and `frame`."""
    path = folder / "log.csv"
    if path.is_file():
        log = list(table_rows(path, ("time_s", "force_n")))
        at, images_at = (
            np.array([number(row.get("time_s", ""), "time_s", where) for where, row in one])
            for one in (log, rows)
        )
        if len(at) < 2 or (np.diff(at) <= 0).any() or not np.ptp(images_at) > 0:
            raise DataError(f"Expected rising times in {path}, and images at several times.")
        frame_s = float(np.median(np.diff(np.unique(images_at))))
        loads = np.array([_loads_of(row) for row in log])
        yield _Film(np.arange(len(rows)), images_at / frame_s, at / frame_s, loads)
        return
    films: dict[tuple[str, str], list[tuple[float, int]]] = {}
    for i, (where, row) in enumerate(rows):
        if row.get("grasp") and row.get("frame"):
            at_frame = number(row["frame"], "frame", where)
            films.setdefault((row["object"], row["grasp"]), []).append((at_frame, i))
    for film in films.values():
        frames, own = (np.array(column) for column in zip(*sorted(film)))
        yield _Film(own, frames, frames, np.array([_loads_of(rows[i]) for i in own]))


def _stated_lag(rows: list[Row], film: _Film) -> int | None:
    """The lag that the table states for a recording; None without one."""
    cells = {(rows[i][1].get("lag_frames") or "", rows[i][0]) for i in film.rows.tolist()}
    stated = {number(cell, "lag_frames", where) for cell, where in cells if cell}
    if len(stated) > 1 or any(one != int(one) for one in stated):
        where = min(where for _, where in cells)
        raise DataError(f"Expected one whole lag_frames for each recording, got {sorted(stated)} ({where}).")
    return int(stated.pop()) if stated else None


def _lag(films: list[_Film], touches: list[Touch]) -> int | None:
    """The lag at which force over volume is steadiest within the films; None if no film has changing loads.

    A film tells it if it has enough frames at half of the lags; at the others it counts as at its worst one.
    """
    volume = np.array([0.0 if why_no_normal(touch) else float(touch.volume_mm3 or 0) for touch in touches])
    scatter = np.array(
        [[_scatter(film.loads(lag)[:, 0], volume[film.rows]) for film in films] for lag in LAGS]
    )
    told = scatter[:, np.isfinite(scatter).mean(axis=0) >= 0.5]
    told = np.where(np.isfinite(told), told, np.nanmax(told, axis=0, initial=0))
    return LAGS[int(np.median(told, axis=1).argmin())] if told.size else None  # one film may slip


def _scatter(force: NDArray[np.float64], volume: NDArray[np.float64]) -> float:
    """Median distance of log F - log V from its median; NaN for few frames, or still ones."""
    there = np.isfinite(force) & (volume > 0) & (force > 0)
    there &= force >= LEAST_SHARE * np.max(force[there], initial=0)
    if np.count_nonzero(there) < 5 or force[there].max() < LEAST_RANGE * force[there].min():
        return float("nan")
    ratio = np.log(force[there]) - np.log(volume[there])
    return float(np.median(np.abs(ratio - np.median(ratio))))
