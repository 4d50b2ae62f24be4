"""Markers: detection, tracking, and their traces in depth; on the real video and on simulated shear with exact truth.

    python benchmarks/markers.py            # about two minutes
    python benchmarks/markers.py --quick    # one seed, nothing written

Writes results/markers.json. The video needs GELFORM_DATA. It has no truth: a swap is counted if two markers have the same
place, or one jumps by half a spacing between frames. The dent is measured on simulated frames: depth at the markers against
the same places of the same gel without markers.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

import gelform
from gelform.image.markers import MarkerFollower, MarkerTracker
from gelform.sensors.profiles import SENSORS
from gelform.simulate import (
    Ball,
    Gel,
    SimulatedSensor,
    press_poses,
    simulate_background,
    simulate_ball_presses,
    simulate_sequence,
    slide_poses,
)
from presses import DATA, presses_of, unlabeled
from report import command_line, table, write

SEEDS = (0, 1)
REST_FRAMES = 12  # of the video, before the first touch


def marked(
    pitch_mm: float, radius_mm: float, seed: int, friction: float, **arguments: float
) -> SimulatedSensor:
    """A GelSight Mini with markers, 6 % missing and 10 % broken."""
    sensor = SENSORS["gelsight-mini"].simulated()
    coating = replace(
        sensor.coating, marker_pitch_mm=pitch_mm, marker_radius_mm=radius_mm, marker_missing=0.06,
        marker_broken=0.1, seed=seed, **arguments,
    )  # fmt: skip
    return replace(sensor, coating=coating, gel=Gel(thickness_mm=5.0, friction=friction))


def sequences(seed: int) -> dict[str, tuple[SimulatedSensor, list[Any]]]:
    """Simulated sequences: markers pressed, and dragged by up to several spacings."""
    press = press_poses(0.9, 6)
    near, far = (slide_poses(0.9, (0, 0), end, count) for end, count in (((0.8, 0.4), 6), ((2.5, 0.8), 24)))
    return {
        "as on a Mini, 0.3 spacings": (marked(1.9, 0.36, seed, 0.8), [*press, *near]),
        "irregular, 0.7 spacings": (marked(1.6, 0.26, seed, 2.0, marker_jitter=0.5), [*press, *near]),
        "dense, 2.5 spacings": (marked(1.0, 0.17, seed, 4.0), [*press, *far]),
    }


def shear(sensor: SimulatedSensor, poses: list[Any], seed: int) -> dict[str, float]:
    """Errors of the tracker, and of single frames, against the truth."""
    rng = np.random.default_rng(seed)
    background = np.mean([simulate_background(sensor, rng) for _ in range(8)], axis=0).astype(np.float32)
    follower = MarkerFollower(background, sensor.mm_per_px)
    tracker, half = MarkerTracker(follower), follower.spacing_px / 2
    errors, ratios, single, seen, within, furthest = [], [], [], [], [], 0.0
    for press in simulate_sequence(sensor, Ball(4), poses, rng=rng):
        assert press is not None
        shift = press.markers_shift_mm / sensor.mm_per_px
        rest = press.markers_px - shift
        apart = np.linalg.norm(follower.rest_px[:, None] - rest, axis=-1)
        own = apart.argmin(axis=1)
        true, now = shift[own], press.markers_px[own]
        flow, alone = tracker.update(press.image), follower(press.image)
        inside = np.all((now > 6) & (now < np.array(sensor.shape[::-1]) - 7), axis=1)
        error = flow.displacement_px - true
        errors.append(error[flow.seen])
        ratios.append(np.abs(error[flow.seen]) / flow.sigma_px[flow.seen, None])
        seen.append(np.mean(flow.seen[inside]))
        near = alone.seen & (np.linalg.norm(true, axis=1) < half)
        single.append((alone.displacement_px - true)[near])
        within.append(np.mean(apart.min(axis=1) < 1.5))
        furthest = max(furthest, float(np.linalg.norm(true[inside], axis=1).max()))
    error, alone_error = np.concatenate(errors), np.concatenate(single)
    size = np.linalg.norm(error, axis=1)
    return {
        "dots": len(follower),
        "real_dots_share": float(np.mean(within)),
        "furthest_spacings": furthest / follower.spacing_px,
        "rms_px": rms(error),
        "median_px": float(np.median(size)),
        "swaps": int(np.sum(size > half)),
        "measured": len(size),
        "seen_share_least": float(min(seen)),
        "single_frame_rms_px": rms(alone_error),
        "single_frame_swaps": int(np.sum(np.linalg.norm(alone_error, axis=1) > half)),
        "within_1_sigma": float(np.mean(np.concatenate(ratios) < 1)),
        "within_2_sigma": float(np.mean(np.concatenate(ratios) < 2)),
    }


def video() -> dict[str, float]:
    """The real video: markers found in the image, swaps, noise at rest, time of a frame."""
    frames = [f.image for f in gelform.Video(DATA / "mini-markers-video" / "mini_example.avi").frames()]
    follower = MarkerFollower(frames[0])
    tracker = MarkerTracker(follower)
    found, swaps, rest, jumps, times = [], 0, [], 0.0, []
    last = follower.rest_px
    for k, image in enumerate(frames):
        started = time.perf_counter()
        flow = tracker.update(image)
        times.append(time.perf_counter() - started)
        margin = follower.radius_px
        inside = np.all((flow.now_px > margin) & (flow.now_px < np.array([319, 239]) - margin), axis=1)
        found.append(np.mean(flow.seen[inside]))
        apart = np.linalg.norm(flow.now_px[:, None] - flow.now_px, axis=-1) + 1e3 * np.eye(len(flow))
        swaps += int(np.sum(apart.min(axis=1)[flow.seen] < 0.4 * follower.spacing_px))
        jump = np.linalg.norm(flow.now_px - last, axis=1)[flow.seen]
        swaps += int(np.sum(jump > follower.spacing_px / 2))
        last, jumps = flow.now_px, max(jumps, float(jump.max()))
        if 0 < k < REST_FRAMES:
            rest.append(flow.displacement_px)
    noise = np.array(rest) - np.mean(rest, axis=0)
    return {
        "dots": len(follower),
        "frames": len(frames),
        "found_share_least": float(min(found)),
        "swaps": swaps,
        "largest_step_px": jumps,
        "noise_at_rest_px": rms(noise),
        "frame_ms_median": 1e3 * float(np.median(times)),
    }


def dent(seed: int) -> dict[str, float]:
    """Depth at the markers of a simulated gel: the error there against the error near them, in presses and at rest."""
    plain = SENSORS["gelsight-mini"].simulated()
    sensor = marked(1.9, 0.36, seed, 0.8)
    rng = np.random.default_rng(seed)
    arguments = {"ball_diameters_mm": [6.0, 8.0], "count": 12, "rng": rng, "oversample": 1}
    simulated = simulate_ball_presses(plain, **arguments)
    calibration = gelform.calibrate(unlabeled(presses_of(simulated)), color_model="hierarchical")
    background = np.mean([simulate_background(sensor, rng) for _ in range(8)], axis=0).astype(np.float32)
    reconstruct = gelform.Reconstructor(replace(calibration, background=background))
    bare = gelform.Reconstructor(calibration)
    found: dict[str, list[float]] = {
        "at_dots": [],
        "beside": [],
        "sigma_at_dots": [],
        "same_place_unmarked": [],
    }
    poses = [*press_poses(0.6, 3), *slide_poses(0.6, (0, 0), (0.6, 0.3), 3)][1:]
    unmarked = replace(plain, gel=sensor.gel)
    pairs = zip(
        simulate_sequence(sensor, Ball(4), poses, rng=rng),
        simulate_sequence(unmarked, Ball(4), poses, rng=rng),
    )
    for press, same in pairs:
        result = reconstruct.from_image(press.image)
        plain_result = bare.from_image(same.image)
        dots = press.albedo < 0.6
        error, other = result.depth_mm - press.depth_mm, plain_result.depth_mm - same.depth_mm
        found["at_dots"].append(rms(error[dots]))
        found["beside"].append(rms(error[~dots]))
        found["same_place_unmarked"].append(rms(other[dots]))
        found["sigma_at_dots"].append(rms(result.depth_sigma_mm[dots]))
    figures = {f"{name}_um": 1e3 * float(np.mean(values)) for name, values in found.items()}
    figures["dent_over_noise"] = figures["at_dots_um"] / figures["same_place_unmarked_um"]
    return figures


def rms(values: Any) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    """Measure, print and record."""
    command = command_line(__doc__)
    command.add_argument("--quick", action="store_true", help="one seed; write nothing")
    quick = command.parse_args().quick
    figures: dict[str, Any] = {"seeds": list(SEEDS[:1] if quick else SEEDS), "shear": {}}
    for seed in figures["seeds"]:
        for name, (sensor, poses) in sequences(seed).items():
            figures["shear"][f"{name}, seed {seed}"] = shear(sensor, poses, seed)
    figures["dent"] = {f"seed {seed}": dent(seed) for seed in figures["seeds"][:1]}
    if (DATA / "mini-markers-video").is_dir():
        figures["video"] = video()
    names = list(next(iter(figures["shear"].values())))
    rows = [[name, *(f"{f[name]:.3g}" for f in figures["shear"].values())] for name in names]
    print(table(["simulated shear", *figures["shear"]], rows))
    for part in ("dent", "video"):
        print(part, figures.get(part, "no data"))
    if not quick:
        write("markers", figures)


if __name__ == "__main__":
    main()
