"""mini-ball and mini-edge: real objects whose shape is known, and simulated ones whose motion is known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import gelform
from edges_of_cube import Line, frames, line_in, on_line
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.starters import load_starter, starter_from_calibration
from gelform.motion.between import moved, step_of_pose
from gelform.simulate import (
    LAYOUTS,
    Ball,
    Cylinder,
    HeightMap,
    Pose,
    Punch,
    simulate_ball_presses,
    simulate_pose,
)
from motion.clips import MINI_MM_PER_PX
from motion.judged import pose_at, sigma_at, two, within, yaw_of
from motion.published import published_pose
from presses import DATA, mini_ball, presses_of, unlabeled, with_circles

OFF_START_MM, OFF_START_RAD = 0.1, 0.02  # standard deviations of the starts about the truth
MOST_YAW_DEG = 9.0
PAIRS = 4  # one of so many pairs of presses of a ball is tried
SIMULATED = 12  # pairs of each kind


def balls(quick: bool) -> dict[str, Any]:
    """mini-ball, each half by the calibration of the other: the center, the rotation claimed, what is named blind."""
    rng = np.random.default_rng(0)
    presses, order = mini_ball()
    presses = presses.subset(order)
    pairs, errors = BallPairs(presses, PAIRS * (4 if quick else 1), rng), []
    for k in (0, 1):
        own, other = (presses.subset(range(j, len(presses.presses), 2)) for j in (k, 1 - k))
        calibration = gelform.calibrate(unlabeled(own))
        errors.append(calibration.settings.place_error)
        pairs.add(calibration, other)
    return pairs.figures() | {"place_error": errors}


def starters(quick: bool) -> dict[str, Any]:
    """Two DIGITs, each by a starter that is made of the other, and by five presses with it as a start: a ball's center."""
    folders = {name: gelform.read_presses(DATA / name) for name in ("digit-ball", "digit-c")}
    made = {name: gelform.calibrate(presses, start=None) for name, presses in folders.items()}
    truth = {name: with_circles(presses, made[name]) for name, presses in folders.items()}
    shipped, found = load_starter("digit"), {}
    for name, other in zip(folders, reversed(folders)):
        starter = starter_from_calibration(
            made[other],
            shipped.sensor,
            units=(other,),
            spread=shipped.spread,
            color_variance=shipped.color_variance,
        )
        presses = truth[name]
        assert presses.background is not None
        unit = starter.for_unit(presses.background, mm_per_px=presses.mm_per_px)
        count = len(presses.presses)
        some = range(0, count, -(-count // 5))
        few = gelform.calibrate(unlabeled(presses, some), start=unit)
        others = presses.subset([i for i in range(count) if i not in some])
        for said, made_of, judged in ((name, unit, presses), (f"{name}, {len(some)} presses", few, others)):
            pairs = BallPairs(presses, PAIRS * (4 if quick else 1), np.random.default_rng(0))
            pairs.add(made_of, judged)
            found[said] = pairs.figures()
    return found


class BallPairs:
    """Motions between presses (labeled) of one ball on one sensor, one of so many pairs, and their errors."""

    def __init__(self, presses: Presses, every: int, rng: np.random.Generator) -> None:
        assert presses.mm_per_px is not None
        self.pitch, self.every, self.rng = float(np.mean(presses.mm_per_px)), every, rng
        self.middle = (np.array(presses.image_shape[::-1]) - 1) / 2
        self.lost = 0
        keys = ("off", "ratio", "turn", "base", "base_turn", "blind", "travel")
        self.found: dict[str, list[Any]] = {key: [] for key in keys}

    def add(self, calibration: gelform.Calibration, presses: Presses) -> None:
        """The pairs of some presses, by a calibration that has not seen them."""
        reconstruct, found = gelform.Reconstructor(calibration), self.found
        results = [(one, reconstruct.from_image(one.image)) for one in presses.presses]
        for i, (one, a) in enumerate(results):
            for two_, b in results[i % PAIRS :: self.every]:
                if two_ is one or one.ball_diameter_mm != two_.ball_diameter_mm:
                    continue
                places = [(np.array(press.label[:2]) - self.middle) * self.pitch for press in (one, two_)]
                travel = places[1] - places[0]
                start = pose_at(*travel + self.rng.normal(0, OFF_START_MM, 2), 0, 0, np.zeros(3))
                motion = gelform.motion_between(
                    a, b, start=start, place_error=calibration.settings.place_error
                )
                if motion.pose is None:
                    self.lost += 1
                    continue
                center = np.array([*places[0], a.peak_mm - one.ball_diameter_mm / 2])
                there = moved(motion.pose, center)
                off = there[:2] - places[1]
                found["off"].append(np.linalg.norm(off))
                found["ratio"] += (off / np.sqrt(np.diag(sigma_at(motion, there))[:2])).tolist()
                found["turn"].append(turn_of(motion.pose, start))
                found["travel"].append(np.linalg.norm(travel))
                found["blind"].append(sum("ball's center" in blind.words for blind in motion.blind))
                pose = published_pose(a, b, start)
                if pose is not None:
                    found["base"].append(np.linalg.norm(moved(pose, center)[:2] - places[1]))
                    found["base_turn"].append(turn_of(pose, start))

    def figures(self) -> dict[str, Any]:
        """Medians and 95 % of both methods, and how often sigma holds."""
        found = self.found
        near = np.array(found["travel"]) < 3
        return {
            "pairs": len(found["off"]), "lost": self.lost, "center_um": two(found["off"], 1e3),
            "center_um_under_3_mm": two(np.array(found["off"])[near], 1e3), "within": within(found["ratio"]),
            "turn_claimed_deg": two(found["turn"]), "published_um": two(found["base"], 1e3),
            "published_turn_claimed_deg": two(found["base_turn"]),
            "blind_named_percent": 100 * float(np.sum(found["blind"])) / (3 * len(found["blind"])),
        }  # fmt: skip


def edges(quick: bool) -> dict[str, Any]:
    """mini-edge by the starter, against the edge's line in the image: its crest, across it, and its yaw."""
    background, images = frames()
    starter = load_starter("gelsight-mini").for_unit(background.astype(np.float32), mm_per_px=MINI_MM_PER_PX)
    reconstruct = gelform.Reconstructor(starter)
    lines = [(image, line_in(image, background, MINI_MM_PER_PX)) for image in images.values()]
    seen = [(reconstruct.from_image(image), line) for image, line in lines if line is not None]
    return {
        "edges": len(seen),
        **_of_lines([line for _, line in seen]),
        **edge_pairs(seen[:8] if quick else seen),
    }


def _of_lines(lines: list[Line]) -> dict[str, Any]:
    """The truth's own error: RMS of what two ways differ by, and standard errors."""
    um = 1e3 * MINI_MM_PER_PX
    values = np.array([(one.apart_px, one.apart_rad, one.error_px, one.error_rad) for one in lines])
    size = np.sqrt(np.mean(np.square(values), axis=0)) * (um, np.degrees(1), um, np.degrees(1))
    return dict(zip(("line_apart_um", "line_apart_deg", "line_error_um", "line_error_deg"), size.tolist()))


def edge_pairs(seen: list[tuple[Any, Line]]) -> dict[str, Any]:
    """Errors of the motion between frames of an edge, by both methods."""
    rng = np.random.default_rng(0)
    found: dict[str, list[Any]] = {
        key: [] for key in ("off", "yaw", "ratio", "ratio_yaw", "base", "base_yaw")
    }
    why: list[str] = []
    published_lost = 0
    for i, (a, one) in enumerate(seen):
        for b, other in seen[:i]:
            angles = [np.arctan2(across[1], across[0]) for across in (one.across, other.across)]
            yaw = float((angles[1] - angles[0] + np.pi) % (2 * np.pi) - np.pi)
            if abs(np.degrees(yaw)) > MOST_YAW_DEG:
                continue
            middle = (np.array(a.shape[::-1]) - 1) / 2
            places = [(line.middle - middle) * MINI_MM_PER_PX for line in (one, other)]
            heights = [
                float(result.depth_mm[on_line(result.shape, line)].mean())
                for result, line in ((a, one), (b, other))
            ]
            crest = np.array([*places[0], heights[0]])
            x, y = places[1] - places[0] + rng.normal(0, OFF_START_MM, 2)
            start = pose_at(x, y, heights[1] - heights[0], yaw + rng.normal(0, OFF_START_RAD), crest)
            motion, pose = gelform.motion_between(a, b, start=start), published_pose(a, b, start)
            if motion.pose is None:
                why.append(motion.why)
            else:
                there = moved(motion.pose, crest)
                covariance = sigma_at(motion, there)
                found["off"].append(float((there[:2] - places[1]) @ other.across))
                found["yaw"].append(yaw_of(motion.pose) - yaw)
                found["ratio"].append(
                    found["off"][-1] / np.sqrt(other.across @ covariance[:2, :2] @ other.across)
                )
                found["ratio_yaw"].append(found["yaw"][-1] / np.sqrt(covariance[5, 5]))
            if pose is None or np.linalg.norm(moved(pose, crest) - moved(start, crest)) > 1:
                published_lost += 1
            else:
                found["base"].append(float((moved(pose, crest)[:2] - places[1]) @ other.across))
                found["base_yaw"].append(yaw_of(pose) - yaw)
    return {
        "pairs": len(found["off"]) + len(why), "lost": {"ours": len(why), "published": published_lost},
        "why_lost": why, "crest_um": two(found["off"], 1e3), "yaw_deg": two(np.degrees(found["yaw"])),
        "within_crest": within(found["ratio"]), "within_yaw": within(found["ratio_yaw"]),
        "published_crest_um": two(found["base"], 1e3), "published_yaw_deg": two(np.degrees(found["base_yaw"])),
    }  # fmt: skip


def turn_of(pose: np.ndarray, start: np.ndarray) -> float:
    """Degrees by which a pose turns beyond its start."""
    return float(np.degrees(np.linalg.norm(step_of_pose(pose @ np.linalg.inv(start), np.zeros(3))[3:])))


def simulated(quick: bool) -> dict[str, Any]:
    """Blind directions of simulated objects, and those wrongly named of textured ones; poses of the latter."""
    sensor, calibration = simulated_sensor()
    reconstruct, rng = gelform.Reconstructor(calibration), np.random.default_rng(2)
    blind = {"ball": (Ball(4.0), 3), "cylinder": (Cylinder(4.0, 30.0), 2), "punch": (Punch(2.5), 1)}
    figures: dict[str, Any] = {}
    count = 3 if quick else SIMULATED

    def pair(indenter: Any, spin_deg: float) -> tuple[Any, np.ndarray, float]:
        first, shift = rng.uniform(-0.8, 0.8, 2), rng.uniform(0.25, 0.4) * direction(rng)
        poses = [Pose(0.5, tuple(first)), Pose(0.5, tuple(first + shift), spin_deg=spin_deg)]
        a, b = (
            reconstruct.from_image(simulate_pose(sensor, indenter, one, rng=rng, oversample=1).image)
            for one in poses
        )
        start = pose_at(*(shift * 0.8), 0, 0, np.zeros(3))
        motion = gelform.motion_between(a, b, start=start, place_error=calibration.settings.place_error)
        return motion, np.array([*first, 0.3]), shift

    for name, (indenter, directions) in blind.items():
        named = [pair(indenter, 0.0)[0] for _ in range(count)]
        usable = [one for one in named if one.pose is not None]
        found = sum(min(len(one.blind), directions) for one in usable)
        figures[name] = {
            "pairs": len(usable),
            "blind": directions,
            "named_percent": 100 * found / (directions * len(usable)),
        }
    off, yaw, ratios, wrongly, usable = [], [], [], 0, 0
    for seed in range(count):
        spin = float(rng.uniform(-5, 5))
        motion, point, shift = pair(textured(seed), spin)
        if motion.pose is None:
            continue
        usable += 1
        wrongly += len(motion.blind)
        there = moved(motion.pose, point)
        error, turned = there[:2] - (point[:2] + shift), yaw_of(motion.pose) - np.radians(spin)
        sigma = np.sqrt(np.diag(sigma_at(motion, there)))
        off.append(np.linalg.norm(error))
        yaw.append(turned)
        ratios += [*(error / sigma[:2]), turned / sigma[5]]
    figures["textured"] = {
        "pairs": usable, "um": two(off, 1e3), "deg": two(np.degrees(yaw)), "within": within(ratios),
        "wrongly_blind_percent": 100 * wrongly / (6 * max(usable, 1)),
    }  # fmt: skip
    return figures


def simulated_sensor() -> tuple[Any, gelform.Calibration]:
    """The layout of three edges, and its calibration from 24 presses."""
    sensor = replace(LAYOUTS["three-edges"])
    made = simulate_ball_presses(
        sensor, ball_diameters_mm=[5.0, 8.0], count=24, rng=np.random.default_rng(11), oversample=1
    )
    return sensor, gelform.calibrate(presses_of(made), color_model="hierarchical")


def textured(seed: int) -> HeightMap:
    """A slightly domed face with bumps in all directions."""
    rng = np.random.default_rng(seed)
    y, x = (np.mgrid[:161, :161] - 80) * 0.05
    waves = rng.uniform(1.2, 3, (10, 2)) * rng.choice([-1, 1], (10, 2))
    bumps = sum(
        h * np.sin(a * x + b * y + p)
        for h, (a, b), p in zip(rng.uniform(0.01, 0.03, 10), waves, rng.uniform(0, 6, 10))
    )
    return HeightMap(bumps - (x**2 + y**2) / 60, 0.05)


def direction(rng: np.random.Generator) -> np.ndarray:
    """A unit vector in the image."""
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])
