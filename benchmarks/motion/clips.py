"""The clips of grasps against the gel's dots: where the object sticks, gel, dots and object move as one rigid body."""

from __future__ import annotations

import csv
import time
from typing import Any

import numpy as np

import gelform
from gelform.calibration.starters import load_starter
from gelform.motion.between import TouchedSurface, moved
from gelform.motion.track import Follower
from motion.judged import sigma_at, timed, two, within, yaw_of
from motion.published import published_pose
from presses import DATA

CLIP, APART = "tennis_ball_1", 80  # frames, at 25 Hz
EVERY = 4
MINI_MM_PER_PX = 0.0634
NEIGHBORS = 5  # clips whose first frames make a background: all begin in contact
STICKS_MM = 0.015  # largest RMS of what is left of the dots' motion after a rigid one
LEAST_DOTS = 4
ALIKE = 15.0  # gray levels; another clip's first frame is of the same unit and light


def clips(quick: bool) -> dict[str, Any]:
    """The named clip by both methods, and all clips for the covariance."""
    names = [
        row["clip"].split("/")[1].removesuffix(".avi")
        for row in csv.DictReader((DATA / "slip" / "clips.csv").open())
    ]
    firsts = {name: next(frames_of(name)) for name in names}
    found = pairs_of(CLIP, firsts, APART // EVERY)
    results = results_of(CLIP, firsts)
    figures: dict[str, Any] = {"pairs": len(found["off_mm"]), "of_dots": summary(found)}
    figures["frame_ms"] = frame_ms(results)
    ratios: dict[str, list[float]] = {"x": [], "y": [], "yaw": []}
    states: list[str] = []
    used = 0
    for name in names[::6] if quick else names:
        one = pairs_of(name, firsts, APART // (2 * EVERY), every=2 * EVERY, baseline=False)
        used += bool(one["off_mm"])
        states += one["state"]
        for key, values in ratios.items():
            values += one[f"ratio_{key}"]
    figures["all_clips"] = {
        "clips": used, "pairs": len(ratios["x"]), **{f"within_{key}": within(v) for key, v in ratios.items()},
        "all": within(np.concatenate([ratios[key] for key in ratios])),
        "cannot_tell_percent": 100 * float(np.mean([one != "found" for one in states])),
    }  # fmt: skip
    return figures


def frames_of(name: str) -> Any:
    """The images of a clip."""
    return (frame.image for frame in gelform.Video(DATA / "slip" / "clips" / f"{name}.avi").frames())


def background_of(name: str, firsts: dict[str, np.ndarray]) -> np.ndarray | None:
    """The median of the first frames of the most similar clips; None if too few are of the same unit and light."""
    low = firsts[name].shape[0] * 3 // 4
    apart = {
        other: float(np.abs(image[low:].astype(float) - firsts[name][low:]).mean())
        for other, image in firsts.items() if other != name
    }  # fmt: skip
    near = sorted(apart, key=lambda other: apart[other])[:NEIGHBORS]
    if apart[near[-1]] > ALIKE:
        return None
    return np.median([firsts[other] for other in near], axis=0).astype(np.float32)


def results_of(name: str, firsts: dict[str, np.ndarray], every: int = EVERY) -> list[Any]:
    """Every fourth frame's result, with the dots followed through all frames."""
    background = background_of(name, firsts)
    if background is None:
        return []
    starter = load_starter("gelsight-mini").for_unit(background, mm_per_px=MINI_MM_PER_PX)
    reconstruct = gelform.Reconstructor(starter)
    if not len(reconstruct.markers):
        return []
    tracker, results = gelform.MarkerTracker(reconstruct.markers), []
    for k, image in enumerate(frames_of(name)):
        flow = tracker.update(image)
        if k % every == 0:
            results.append(reconstruct.from_image(image, markers=flow))
    return results


def dots_motion(a: Any, b: Any) -> tuple[np.ndarray, np.ndarray, float, float, np.ndarray] | None:
    """The rigid motion of the dots in the contact: middle before and after (mm), yaw, RMS left, variances of x, y, yaw."""
    surface = TouchedSurface(a)
    height, width = a.shape
    middle = np.array([width - 1, height - 1]) / 2
    before, after = ((flow.now_px - middle) * MINI_MM_PER_PX for flow in (a.markers, b.markers))
    row = np.rint(before / surface.pitch + surface.origin)[:, ::-1].astype(int)
    inside = np.all((row >= 0) & (row < surface.closed.shape), axis=1) & a.markers.seen & b.markers.seen
    inside[inside] = surface.closed[tuple(row[inside].T)]
    if inside.sum() < LEAST_DOTS:
        return None
    before, after = before[inside], after[inside]
    one, other = before - before.mean(axis=0), after - after.mean(axis=0)
    yaw = float(np.arctan2(np.sum(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]), np.sum(one * other)))
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    left = float(np.sqrt(np.mean(np.sum((one @ turn.T - other) ** 2, axis=1))))
    count = int(inside.sum())
    single = count * left**2 / (2 * count - 3)  # of one dot along an axis; the fit has three unknowns
    variances = np.array([single / count, single / count, single / np.sum(one**2)])
    return before.mean(axis=0), after.mean(axis=0), yaw, left, variances


def pairs_of(
    name: str, firsts: dict[str, np.ndarray], apart: int, every: int = EVERY, *, baseline: bool = True
) -> dict[str, list[Any]]:
    """Errors of the sticking pairs of a clip; those of the dots' own middle count in the ratios to sigma."""
    found: dict[str, list[Any]] = {
        key: []
        for key in ("off_mm", "yaw", "base_mm", "base_yaw", "ratio_x", "ratio_y", "ratio_yaw", "state")
    }
    results = results_of(name, firsts, every)
    for a, b in zip(results, results[apart:]):
        motion = gelform.motion_between(a, b)
        dots = dots_motion(a, b) if motion.pose is not None else None
        if dots is None or dots[3] > STICKS_MM:
            continue
        before, after, yaw, _, own = dots
        point = np.array([*before, motion.center_mm[2]])
        there = moved(motion.pose, point)
        off, turned = there[:2] - after, yaw_of(motion.pose) - yaw
        sigma = np.sqrt(np.diag(sigma_at(motion, there))[[0, 1, 5]] + own)
        found["off_mm"].append(np.linalg.norm(off))
        found["yaw"].append(turned)
        found["ratio_x"].append(off[0] / sigma[0])
        found["ratio_y"].append(off[1] / sigma[1])
        found["ratio_yaw"].append(turned / sigma[2])
        found["state"].append(motion.state)
        pose = published_pose(a, b, np.eye(4)) if baseline else None
        if pose is not None:
            found["base_mm"].append(np.linalg.norm(moved(pose, point)[:2] - after))
            found["base_yaw"].append(yaw_of(pose) - yaw)
    return found


def summary(found: dict[str, list[Any]]) -> dict[str, Any]:
    """Median and 95 % of both methods, um and degrees."""
    return {
        "um": two(found["off_mm"], 1e3), "deg": two(np.degrees(found["yaw"])),
        "published_um": two(found["base_mm"], 1e3), "published_deg": two(np.degrees(found["base_yaw"])),
    }  # fmt: skip


def frame_ms(results: list[Any]) -> dict[str, float]:
    """CPU milliseconds of a frame of a track, and of a pair by the published objective in numpy."""
    follower = Follower(None, 0.01)
    times = []
    for result in results:
        result.contact, result.known, result.gradients_sigma, result.depth_sigma_mm  # noqa: B018, computed on first use
        began = time.process_time()
        follower(result)
        times.append(1e3 * (time.process_time() - began))
    pair = timed(lambda: published_pose(results[0], results[1], np.eye(4)), time.process_time, 9)
    return {"track": float(np.median(times)), "published_in_numpy": pair}
