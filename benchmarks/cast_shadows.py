"""Part of confidence.py: sensors whose presses cast shadows, with the shadows taken back and without.

A DIGIT drawn anew has the lights of the preset moved by 1.5 mm (sd) and up to 30 % brighter or dimmer, another gel and
another coating. Rules were chosen on the preset itself and on digit-ball; the sensors reported are of other seeds.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import gelform
from gelform.ball import ball_center, ball_gradients
from gelform.calibration.circles.find import find_contact, why_no_contact
from gelform.calibration.circles.prepare import ColorChanges
from gelform.metrics import angle_deg, press_errors
from gelform.simulate import (
    Ball,
    BoxEdge,
    Cylinder,
    SimulatedPress,
    SimulatedSensor,
    simulate_ball_presses,
    simulate_press,
)
from gelform.simulate.presets import digit

SEEDS = 201, 202, 203  # of the sensors that are reported
BALLS_MM = (4.7, 6.5)
FOLLOWED = 0.6  # of the visible circle of digit-ball: there the gel leaves the ball


def drawn_digit(seed: int) -> SimulatedSensor:
    """A DIGIT that is not the preset."""
    rng, first = np.random.default_rng(seed), digit()
    moves, gains = rng.normal(0, (1.5, 1.5, 0.7), (3, 3)), rng.uniform(0.7, 1.3, 3)
    leds = tuple(
        replace(
            led,
            position_mm=tuple(np.add(led.position_mm, moves[k // 3]).tolist()),
            color=tuple((np.array(led.color) * gains[k // 3]).tolist()),
        )
        for k, led in enumerate(first.leds)
    )
    return replace(
        first,
        leds=leds,
        relaxation_mm=float(rng.uniform(0.45, 0.75)),
        noise_sd=float(rng.uniform(1.2, 2.2)),
        coating=replace(first.coating, scattering=float(rng.uniform(0.1, 0.3)), seed=seed),
    )


def calibrated(sensor: SimulatedSensor, seed: int, count: int = 24) -> gelform.Calibration:
    """From presses of two balls."""
    made = simulate_ball_presses(
        sensor, ball_diameters_mm=BALLS_MM, count=count, rng=np.random.default_rng(seed), oversample=1
    )
    with tempfile.TemporaryDirectory() as folder:
        gelform.save_simulated_presses(Path(folder) / "presses", made)
        return gelform.calibrate(gelform.read_presses(Path(folder) / "presses"), color_model="hierarchical")


def both(calibration: gelform.Calibration) -> tuple[gelform.Reconstructor, gelform.Reconstructor]:
    """With cast shadows taken back, and without."""
    assert calibration.forward is not None
    without = replace(calibration, forward=replace(calibration.forward, shadow_noise=None))
    return tuple(gelform.Reconstructor(one, depth_sigma=False) for one in (calibration, without))  # type: ignore[return-value]


def object_on(sensor: SimulatedSensor, rng: np.random.Generator) -> tuple[str, SimulatedPress]:
    """A ball, a cylinder or an edge, 0.3 to 0.9 mm deep."""
    while True:
        kind = str(rng.choice(["ball", "ball", "cylinder", "edge"]))
        made: Any = {
            "ball": lambda: Ball(float(rng.uniform(2, 3.2))),
            "cylinder": lambda: Cylinder(float(rng.uniform(1.5, 3)), float(rng.uniform(3, 6))),
            "edge": lambda: BoxEdge(float(rng.uniform(3, 6)), float(rng.uniform(110, 150))),
        }[kind]()
        x, y = rng.uniform(-0.3, 0.3, 2) * sensor.shape[::-1] * sensor.mm_per_px
        depth, spin = float(rng.uniform(0.3, 0.9)), float(rng.uniform(0, 180))
        try:
            return kind, simulate_press(
                sensor, made, depth_mm=depth, center_mm=(float(x), float(y)), spin_deg=spin, rng=rng, oversample=1
            )  # fmt: skip
        except ValueError:  # beside the image
            continue


def simulated(frames: int, folder: Path, seeds: tuple[int, ...] = SEEDS) -> dict[str, Any]:
    """RMS depth error in the contact, um, with the shadows taken back, without, and the ratio; the mean over frames.

    Calibrations are kept in the folder, and taken from there.
    """
    found: dict[str, Any] = {}
    for seed in seeds:
        sensor = drawn_digit(seed)
        path = folder / f"digit-{seed}.npz"
        if not path.is_file():
            calibrated(sensor, seed).save(path)
        calibration, rng = gelform.load_calibration(path), np.random.default_rng(seed + 1)
        pair, errors = both(calibration), []
        kinds, ends = [], []
        for _ in range(frames):
            kind, truth = object_on(sensor, rng)
            depths = [one.from_image(truth.image).depth_mm for one in pair]
            kinds.append(kind)
            errors.append([1e3 * np.sqrt(np.mean((z - truth.depth_mm)[truth.contact] ** 2)) for z in depths])
            ends.append([1e3 * np.sqrt(np.mean((z - truth.depth_mm) ** 2)) for z in depths])
        rows = np.array(errors)
        found[f"sensor {seed}"] = {
            "casts_shadows": calibration.forward is not None and calibration.forward.shadow_noise is not None,
            **_pair(rows),
            "frame": _pair(np.array(ends)),
            **{kind: _pair(rows[np.array(kinds) == kind]) for kind in sorted(set(kinds))},
        }
    return found


def _pair(rows: np.ndarray) -> dict[str, float]:
    with_, without = rows.mean(axis=0)
    return {"um": float(with_), "without_um": float(without), "ratio": float(with_ / without)}


def real(calibration: gelform.Calibration, presses: Any) -> dict[str, Any]:
    """Presses of a real DIGIT that the calibration has not seen, with the shadows taken back and without.

    `lit_deg`: normal error where every light of the preset, which was fitted to this sensor, is in front of the ball;
    `contact_deg` everywhere, both in the visible circle less 3 px. `cap_um`: depth minus the ball there. The gel leaves the
    ball at 0.6 of that circle, which the presses that calibrate tell: `followed_` is the same inside of it, its centre from
    0.55. `beyond_um`: depth outside 1.5 circles.
    """
    names = (
        "lit_deg", "contact_deg", "inner_deg", "cap_um", "off_contact_um",
        "followed_deg", "followed_lit_deg", "followed_cap_um", "beyond_um",
    )  # fmt: skip
    rows = [[] for _ in range(2)]  # type: ignore[var-annotated]
    changes = ColorChanges(calibration.background, calibration.change)
    for one in presses.presses:
        contact = find_contact(changes(one.image)[0])
        if why_no_contact(contact) is None:
            for reconstruct, into in zip(both(calibration), rows):
                into.append(_errors(reconstruct.from_image(one.image), contact.circle_px, one))
    means = np.mean(rows, axis=1)
    found: dict[str, Any] = {"presses": len(rows[0])}
    for name, (with_, without) in zip(names, means.T):
        found[name] = {"with": float(with_), "without": float(without), "ratio": float(with_ / without)}
    return found


def _errors(result: gelform.Reconstruction, circle: Any, one: Any) -> list[float]:
    mm, radius = result.mm_per_px, one.ball_diameter_mm / 2
    y, x = np.mgrid[: result.shape[0], : result.shape[1]]
    zone = np.hypot(x - circle[0], y - circle[1]) < 0.8 * circle[2]
    center = ball_center(result.gradients[zone], x[zone], y[zone], circle[:2], radius / mm)
    errors = press_errors(
        result.depth_mm,
        result.gradients,
        circle_px=(*center, circle[2]),
        ball_radius_mm=radius,
        mm_per_px=mm,
    )
    near = np.hypot(x - center[0], y - center[1]) < min(circle[2] - 3, 0.97 * radius / mm)
    truth = ball_gradients(x, y, center, radius / mm)
    lit = near & _lit(truth, mm)
    lit_deg = float(angle_deg(result.gradients[lit], truth[lit]).mean())
    return [
        lit_deg, errors.normal_free_deg, errors.normal_inner_deg, errors.cap_free_um, errors.off_contact_um,
        *_followed(result, circle, radius / mm),
    ]  # fmt: skip


def _followed(result: gelform.Reconstruction, circle: Any, ball_px: float) -> list[float]:
    y, x = np.mgrid[: result.shape[0], : result.shape[1]]
    zone = np.hypot(x - circle[0], y - circle[1]) < 0.55 * circle[2]
    center = ball_center(result.gradients[zone], x[zone], y[zone], circle[:2], ball_px)
    away = np.hypot(x - center[0], y - center[1])
    near, truth = away < FOLLOWED * circle[2], ball_gradients(x, y, center, ball_px)
    angle = angle_deg(result.gradients, truth)
    cap = result.depth_mm - result.mm_per_px * np.sqrt(np.maximum(ball_px**2 - away**2, 0))
    beyond = result.depth_mm[away > 1.5 * circle[2]]
    return [
        float(angle[near].mean()),
        float(angle[near & _lit(truth, result.mm_per_px)].mean()),
        float(1e3 * cap[near].std()),
        float(1e3 * np.sqrt(np.mean(beyond**2))),
    ]


def _lit(gradients: np.ndarray, mm_per_px: float) -> np.ndarray:
    """Where all lights of the preset are in front of a surface of these slopes (H, W, 2)."""
    height, width = gradients.shape[:2]
    y, x = (np.mgrid[:height, :width] - np.array([height - 1, width - 1])[:, None, None] / 2) * mm_per_px
    lit = np.ones((height, width), dtype=bool)
    for led in digit().leds:
        toward = np.array(led.position_mm)
        lit &= gradients[..., 0] * (toward[0] - x) + gradients[..., 1] * (toward[1] - y) < toward[2]
    return lit
