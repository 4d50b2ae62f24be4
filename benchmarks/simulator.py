"""Figures of the simulator: exactness, speed, similarity to real sensors, identical bytes.

    python benchmarks/simulator.py -o benchmarks/results/simulator.json

Speed is processor time of one thread, compared with D, a bare float32 cosine transform and its inverse of the same
size in the same run: the minimum of many repetitions, because the machine is shared, and the median. Similarity needs
the real data (GELFORM_DATA). `--calibration` and `--digit-calibration` take calibrations from the presses 0, 2, 4 ...
of mini-ball and digit-ball; without them they are made, which takes minutes.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.fft import dctn, idctn

import gelform
from gelform.exchange.exporters.simulated import SetOfPresses, save_simulated_set
from gelform.exchange.importers.tables import TaximLook, read_taxim_forward
from gelform.sensors.profiles import SENSORS
from gelform.simulate import (
    LAYOUTS,
    Ball,
    Coating,
    Coin,
    Gel,
    Led,
    Optics,
    Pose,
    Screw,
    SimulatedSensor,
    Timing,
    exposed,
    simulate_background,
    simulate_press,
    simulate_sequence,
    slide_poses,
)
from gelform.simulate.gel.ball_press import depth_of_ball
from gelform.simulate.twin import GEL, RELAXATION_MM, Twin
from gelform.slopes.gradients import gradients_from_normals
from gelform.slopes.normals import normals_from_image
from presses import DATA, Circle, reference_circles

RIM_MM = (
    0.25  # how far inside the rim that one sees a GelSight Mini's gel leaves the ball, found on ball presses
)


def far_lights() -> tuple[SimulatedSensor, np.ndarray]:
    """Three distant lights, one per channel, and their matrix for photometric stereo."""
    directions = np.array([[0.55, 0.0, 0.83], [-0.28, 0.48, 0.83], [-0.28, -0.48, 0.83]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    far = 1e8
    leds = tuple(
        Led(tuple(map(float, far * d)), tuple(map(float, 150 * far**2 * np.eye(3)[c])))
        for c, d in enumerate(directions)
    )
    return SimulatedSensor(leds), 150 * directions


def exactness() -> dict[str, float]:
    """One light on a ball against Lambert's law; depth from normals of a noise-free frame."""
    sensor, lights = far_lights()
    press = simulate_press(sensor, Ball(3), depth_mm=0.8, rng=None, oversample=1, quantise=False)
    analytic = np.maximum(press.normals @ lights.T, 0)
    result = {
        "forward_against_analytic_relative": float(np.abs(press.image - analytic).max() / analytic.max())
    }
    for name, quantise in (("unquantised", False), ("8_bits", True)):
        shown = simulate_press(sensor, Ball(3), depth_mm=0.8, rng=None, oversample=1, quantise=quantise)
        normals, _ = normals_from_image(shown.image.astype(np.float32), lights)
        depth = gelform.depth_from_gradients(
            gradients_from_normals(normals), mm_per_px=sensor.mm_per_px, zero="mean", solver="dct"
        )
        error = depth - (press.depth_mm - press.depth_mm.mean())
        result[f"depth_rmse_um_{name}"] = float(1000 * np.sqrt(np.mean(error**2)))
    return result


def cpu_ms(work: Callable[[], Any], repeats: int) -> tuple[float, float]:
    """Minimum and median processor time of the calling thread, ms."""
    work()
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return 1000 * min(times), 1000 * float(np.median(times))


def everything_on() -> SimulatedSensor:
    """A sensor with every part of the model active, except cast shadows."""
    base = LAYOUTS["three-edges"]
    sensor = replace(
        base,
        leds=tuple(replace(led, beam_power=1) for led in base.leds),
        gel=Gel(thickness_mm=3.0, bulge=0.6),
        coating=Coating(
            specular=0.1,
            scattering=0.3,
            interreflection=0.1,
            roughness=0.01,
            scratches=4,
            dust=5,
            marker_pitch_mm=2.0,
        ),
        optics=Optics(height_mm=25.0, distortion=(-0.05, 0.0), response_gamma=1.2, jpeg_quality=90),
        timing=Timing(flicker=0.01, readout_s=0.01, drift=(0.05, 0.02, 0.0)),
        shading=((1.0, 0.0, 0.0, 0.0, 0.0, 0.0),) * 3,
    )
    return exposed(sensor, (78, 95, 105))


def speed() -> dict[str, Any]:
    """Frames per second of a sliding ball at 240x320, and single presses, compared with D."""
    cv2.setNumThreads(1)
    pair = np.random.default_rng(0).standard_normal((240, 320)).astype(np.float32)
    full = everything_on()
    result: dict[str, Any] = {}
    for name, sensor in (
        ("plain", LAYOUTS["three-edges"]),
        ("cast_shadows", replace(LAYOUTS["three-edges"], cast_shadows=True)),
        ("everything_but_cast_shadows", full),
        ("everything", replace(full, cast_shadows=True)),
    ):
        frames = simulate_sequence(
            sensor, Ball(3), slide_poses(0.6, (-3, 0), (3, 0), 240), rng=np.random.default_rng(0)
        )
        frame, transform = [], []
        for _ in range(24):
            transform.append(cpu_ms(lambda: idctn(dctn(pair)), 20))
            frame.append(cpu_ms(lambda frames=frames: next(frames), 9))
        least, d = np.min(frame, axis=0)[0], np.min(transform, axis=0)[0]
        usual, usual_d = np.median(frame, axis=0)[1], np.median(transform, axis=0)[1]
        result[name] = {
            "fps": 1000 / least,
            "ms": least,
            "D_ms": d,
            "in_D": least / d,
            "median_ms": usual,
            "median_D_ms": usual_d,
        }
    for indenter in (Ball(3), Coin(), Screw()):
        one, _ = cpu_ms(
            lambda indenter=indenter: simulate_press(
                LAYOUTS["three-edges"], indenter, depth_mm=0.4, rng=None, oversample=3
            ),
            5,
        )
        result[f"press_{type(indenter).__name__}_oversample_3_ms"] = one
    return result


def same_bytes() -> bool:
    """Whether one worker and two write the same data set."""
    wanted = SetOfPresses(
        replace(SENSORS["digit"].simulated(), shape=(80, 60), mm_per_px=0.2), (5.0,), count=4, seed=3
    )
    with tempfile.TemporaryDirectory() as folder:
        kept = []
        for workers in (1, 2):
            made = save_simulated_set(Path(folder) / str(workers), wanted, workers=workers)
            kept.append({p.relative_to(made): p.read_bytes() for p in made.rglob("*") if p.is_file()})
    return kept[0] == kept[1]


def backgrounds() -> dict[str, Any]:
    """Presets compared with real backgrounds: mean levels and shape."""
    result = {}
    for name, folder in (("gelsight-mini", "mini-ball"), ("digit", "digit-ball")):
        real = cv2.imread(str(DATA / folder / "background.png"))[..., ::-1].astype(np.float64)
        made = simulate_background(SENSORS[name].simulated(), None, quantise=False)
        apart = cv2.GaussianBlur(real, (0, 0), 2) - cv2.GaussianBlur(made, (0, 0), 2)
        result[name] = {
            "mean_real": real.mean((0, 1)).tolist(),
            "mean_simulated": made.mean((0, 1)).tolist(),
            "shape_rmse": np.sqrt(np.mean(apart**2, axis=(0, 1))).tolist(),
        }
    return result


def half_calibrated(name: str, path: Path | None) -> gelform.Calibration:
    """A calibration from the presses 0, 2, 4 ... of mini-ball or digit-ball."""
    if path is not None:
        return gelform.load_calibration(path)
    presses = gelform.read_presses(DATA / name)
    half = presses.subset(range(0, len(presses.presses), 2))
    return gelform.calibrate(half, color_model="polynomial")


def likeness(calibration: gelform.Calibration) -> dict[str, Any]:
    """Held-out real presses of mini-ball compared with `--like` and the preset, in gray levels.

    Inside the visible rim, and inside the smaller circle in which the twin's gel touches the ball.
    """
    circles, twin, preset = reference_circles(), Twin(calibration), SENSORS["gelsight-mini"].simulated()
    rest = simulate_background(preset, None, quantise=False)
    errors: dict[str, list[float]] = {
        "like": [],
        "like_touching": [],
        "like_with_noise": [],
        "preset_change": [],
        "real_change": [],
    }
    changes: dict[str, list[np.ndarray]] = {"real": [], "like": [], "preset": []}
    means: dict[str, list[np.ndarray]] = {"real": [], "like": [], "preset": []}
    rng = np.random.default_rng(0)
    for press in gelform.read_presses(DATA / "mini-ball").presses[1::2]:
        circle = circles[press.name]
        pose, ball = _pose_of(press, circle, twin.sensor)
        made = twin.press(ball, pose, rng=None)
        noisy = twin.press(ball, pose, rng=rng)
        by_preset = simulate_press(
            preset, ball, depth_mm=pose.depth_mm, center_mm=pose.center_mm, rng=None, quantise=False
        )
        inside = _inside(circle, made.contact.shape)
        apart = np.abs(press.image.astype(np.float64) - made.image)
        real = (press.image - calibration.background.astype(np.float64))[inside]
        errors["like"].append(float(apart[inside].mean()))
        errors["like_touching"].append(float(apart[made.contact].mean()))
        errors["like_with_noise"].append(
            float(np.abs(press.image.astype(np.float64) - noisy.image)[inside].mean())
        )
        errors["preset_change"].append(float(np.abs(real - (by_preset.image - rest)[inside]).mean()))
        errors["real_change"].append(float(np.abs(real).mean()))
        changes["real"].append(real)
        changes["like"].append((noisy.image - calibration.background)[inside])
        changes["preset"].append((by_preset.image - rest)[inside])
        if press.ball_diameter_mm < 7:
            for name, image, untouched in (
                ("real", press.image, calibration.background),
                ("like", made.image, calibration.background),
                ("preset", by_preset.image, rest),
            ):
                means[name] += _cut_out(image - untouched.astype(np.float64), circle)
    mean = {name: np.mean(cuts, axis=0) for name, cuts in means.items()}
    quantiles = {
        k: np.quantile(np.concatenate(v), np.linspace(0.005, 0.995, 199), axis=0) for k, v in changes.items()
    }
    return {
        "presses": len(errors["like"]),
        "mean_absolute_difference_like": float(np.mean(errors["like"])),
        "median_over_presses_like": float(np.median(errors["like"])),
        "mean_absolute_difference_like_touching": float(np.mean(errors["like_touching"])),
        "mean_absolute_difference_like_with_noise": float(np.mean(errors["like_with_noise"])),
        "mean_absolute_difference_preset": float(np.mean(errors["preset_change"])),
        "mean_absolute_change_of_the_presses": float(np.mean(errors["real_change"])),
        "histogram_distance_like": np.abs(quantiles["real"] - quantiles["like"]).mean(0).tolist(),
        "histogram_distance_preset": np.abs(quantiles["real"] - quantiles["preset"]).mean(0).tolist(),
        "mean_press": {
            "presses": len(means["real"]),
            "rms_of_its_change": float(np.sqrt(np.mean(mean["real"] ** 2))),
            "rmse_like": float(np.sqrt(np.mean((mean["real"] - mean["like"]) ** 2))),
            "rmse_preset": float(np.sqrt(np.mean((mean["real"] - mean["preset"]) ** 2))),
        },
        "image_noise": twin.look.noise.tolist(),
    }


def _cut_out(change: np.ndarray, circle: Circle) -> list[np.ndarray]:
    """A list of 81x81 pixels of a change around a circle's center; empty if they leave the image."""
    x, y = round(circle[0]), round(circle[1])
    cut = change[max(y - 40, 0) : y + 41, max(x - 40, 0) : x + 41]
    return [cut] if cut.shape[:2] == (81, 81) else []


def digit_likeness(calibration: gelform.Calibration) -> dict[str, Any]:
    """Held-out presses of a DIGIT compared with its own `--like`, Taxim's tables of another DIGIT, and the preset.

    Gray levels inside 0.8 of the contact radius that `evaluate` finds. The scale of these presses is not verified: the
    figures show which look is nearer, but not how near.
    """
    presses = gelform.read_presses(DATA / "digit-ball")
    held_out = presses.subset(range(1, len(presses.presses), 2))
    twin, preset = Twin(calibration), SENSORS["digit"].simulated()
    turned = np.ascontiguousarray(np.rot90(calibration.background, -1))
    tables = read_taxim_forward(DATA / "peer-calibrations" / "taxim-digit-polycalib.npz")
    taxim = TaximLook(tables, turned, float(twin.sensor.mm_per_px), np.zeros(3))
    rest = simulate_background(preset, None, quantise=False)
    errors: dict[str, list[float]] = {"like": [], "taxim": [], "preset": [], "no_change": []}
    for press, row in zip(held_out.presses, gelform.evaluate(calibration, held_out).rows):
        if row["reason"] is not None:
            continue
        circle = tuple(map(float, row["circle_px"]))
        pose, ball = _pose_of(press, circle, twin.sensor)
        made = twin.press(ball, pose, rng=None)
        by_taxim = _levels_of_turned(taxim, made)
        by_preset = simulate_press(
            preset, ball, depth_mm=pose.depth_mm, center_mm=pose.center_mm, rng=None, quantise=False
        )
        inside = _inside((*circle[:2], 0.8 * circle[2]), rest.shape)
        real = press.image.astype(np.float64)
        for name, image in (
            ("like", made.image),
            ("taxim", by_taxim),
            ("preset", calibration.background + by_preset.image - rest),
            ("no_change", calibration.background),
        ):
            errors[name].append(float(np.abs(real - image)[inside].mean()))
    return {"presses": len(errors["like"]), **{name: float(np.mean(v)) for name, v in errors.items()}}


def _levels_of_turned(look: TaximLook, press: Any) -> np.ndarray:
    """The response of tables for a camera turned by 90 degrees to an upright press: x of the tables is up, y right."""
    gradients = np.rot90(np.stack([-press.gradients[..., 1], press.gradients[..., 0]], axis=-1), -1)
    return np.rot90(look.levels(gradients, np.rot90(press.depth_mm, -1)), 1)


def transfer(calibration: gelform.Calibration) -> dict[str, Any]:
    """Calibrate on the twin's presses, test on real ones, and compare with the real calibration on the same ones.

    The twin presses the same balls at the same places and depths as the half of real presses that made it, with the
    found circles instead of the reference's. Its presses are calibrated as a folder without labels. The test uses the
    presses 1, 3, 5 ...
    """
    presses = gelform.read_presses(DATA / "mini-ball")
    circles, twin = reference_circles(), Twin(calibration)
    training = presses.subset(range(0, len(presses.presses), 2))
    rng = np.random.default_rng(0)
    made = []
    for press, row in zip(training.presses, gelform.evaluate(calibration, training).rows):
        if row["reason"] is not None:
            continue
        circle = tuple(map(float, row["circle_px"]))
        pose, ball = _pose_of(press, circle, twin.sensor)
        made.append(replace(press, image=twin.press(ball, pose, rng=rng).image, label=None))
    pretended = replace(presses, presses=tuple(made), background=calibration.background)
    by_twin = gelform.calibrate(pretended, color_model="polynomial")
    held_out = presses.subset(range(1, len(presses.presses), 2))
    labeled = tuple(replace(press, label=circles[press.name]) for press in held_out.presses)
    found = {
        name: gelform.evaluate(one, replace(held_out, presses=labeled)).summary
        for name, one in (("real", calibration), ("like", by_twin))
    }
    ratio = {key: found["like"][key] / found["real"][key] for key in found["real"] if key not in ("presses",)}
    return {**found, "ratio": ratio, "rejected_by_like": len(made) - by_twin.settings["presses"]}


def _inside(circle: Circle, shape: tuple[int, ...]) -> np.ndarray:
    x, y, a = circle
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    return np.asarray((columns - x) ** 2 + (rows - y) ** 2 < a**2)


def _pose_of(press: Any, circle: Circle, sensor: SimulatedSensor) -> tuple[Pose, Ball]:
    """The pose whose visible rim is the known circle of a real press."""
    x, y, a = circle
    radius = press.ball_diameter_mm / 2
    height, width = sensor.shape
    center = (x - (width - 1) / 2) * sensor.mm_per_px, (y - (height - 1) / 2) * sensor.mm_per_px
    rim_mm = a * sensor.mm_per_px
    contact = min(max(rim_mm - RIM_MM, 0.05 * rim_mm), 0.95 * radius)
    slope = contact / np.sqrt(radius**2 - contact**2)
    depth = depth_of_ball(radius, slope, RELAXATION_MM, thickness_mm=GEL.thickness_mm, bulge=GEL.bulge)
    return Pose(depth, center), Ball(radius)


def main() -> None:
    """Measure, print and, with -o, write."""
    parser = argparse.ArgumentParser()
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--calibration", type=Path)
    parser.add_argument("--digit-calibration", type=Path)
    arguments = parser.parse_args()
    figures: dict[str, Any] = {"exactness": exactness(), "speed": speed(), "same_bytes": same_bytes()}
    if DATA.is_dir():
        half = half_calibrated("mini-ball", arguments.calibration)
        figures |= {"backgrounds": backgrounds(), "likeness": likeness(half), "transfer": transfer(half)}
        figures["digit_likeness"] = digit_likeness(half_calibrated("digit-ball", arguments.digit_calibration))
    text = json.dumps(figures, indent=1)
    print(text)
    if arguments.output is not None:
        arguments.output.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
