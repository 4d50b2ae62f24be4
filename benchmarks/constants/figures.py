"""What a trial looks at: figures of frames, changed light, dots, motion, force, streams and presses, by part."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

DATA = Path(os.environ.get("GELFORM_DATA", Path(__file__).parents[3] / "shared" / "data"))
SETS = ("mini-ball", "digit-ball", "gelslim-dots", "mini-d", "homemade-even/a")
REFINED = ("mini-ball",)  # whose presses are fitted in each trial
PRESSES, FRAMES = 13, 3
Figures = dict[str, Any]


def pressed(name: str, count: int = PRESSES) -> Any:
    """Presses of a set, evenly chosen, without circles of people."""
    import gelform
    from presses import unlabeled

    presses = gelform.read_presses(DATA / name)
    chosen = np.unique(np.linspace(0, len(presses.presses) - 1, count).round().astype(int))
    return unlabeled(presses, chosen.tolist())


def given() -> dict[str, bytes]:
    """What all trials share, pickled: calibrations by few presses of each set and of a simulated sensor; loads."""
    import force
    import gelform
    from presses import presses_of

    found: dict[str, Any] = {name: gelform.calibrate(pressed(name)) for name in SETS}
    sensor = _small()
    made = gelform.simulate.simulate_ball_presses(
        sensor, ball_diameters_mm=[5.0, 8.0], count=20, rng=np.random.default_rng(3), oversample=1
    )
    found["simulated"] = gelform.calibrate(presses_of(made), color_model="hierarchical")
    found["loads"] = force.pressed()
    return {name: pickle.dumps(one) for name, one in found.items()}


def _small() -> Any:
    from dataclasses import replace

    from gelform.simulate import LAYOUTS

    return replace(LAYOUTS["three-edges"], shape=(132, 176), mm_per_px=0.1153)


def _of_result(result: Any, key: str, findings: bool = True) -> Figures:
    found = {
        f"{key} depth": float(result.depth_mm.max()),
        f"{key} contact": int(result.contact.sum()),
        f"{key} contacts": len(result.contacts),
        f"{key} sigma": float(np.median(result.depth_sigma_mm)),
        f"{key} confidence": float(result.confidence.mean()),
    }
    if findings:
        found[f"{key} findings"] = ", ".join(f"{one.name} {one.figure:.4g}" for one in result.health)
    return found


def frames(shared: dict[str, bytes]) -> Figures:
    """Frames of each set, by a calibration of its presses."""
    import gelform

    figures: Figures = {}
    for name in SETS:
        reconstruct = gelform.Reconstructor(pickle.loads(shared[name]))
        for k, press in enumerate(pressed(name).presses[1 :: PRESSES // FRAMES]):
            figures |= _of_result(reconstruct(press.image), f"{name} {k}")
    return figures


def light(shared: dict[str, bytes]) -> Figures:
    """Frames in another light, moved, torn, turned, with clipped channels, and of another gel; and backgrounds."""
    import gelform
    from gelform.image.agreement import check_own_background, touch_in, touch_in_first

    figures: Figures = {}
    for name in ("mini-ball", "digit-ball"):
        calibration = pickle.loads(shared[name])
        presses, background = pressed(name).presses, calibration.background
        reconstruct = gelform.Reconstructor(calibration)
        for kind, image in _changed(presses[2].image, background):
            key = f"{name} {kind}"
            try:
                figures |= _of_result(reconstruct(image), key)
            except gelform.errors.GelformError as problem:
                figures[f"{key} findings"] = f"refused: {type(problem).__name__} {str(problem)[:60]}"
        for kind, image in _changed(background, background):
            key = f"{name} rest, {kind}"
            try:
                said = [f"{one.name} {one.figure:.3g}" for one in check_own_background(image, background)]
            except gelform.errors.GelformError as problem:
                said = [str(problem)[:60]]
            touch = touch_in(image, background) if image.shape == background.shape else None
            figures[f"{key} findings"] = f"{said} {touch}"
        first = touch_in_first(presses[0].image.astype(np.float32), background)
        figures[f"{name} first findings"] = f"{first} {touch_in(presses[0].image.astype(np.float32))}"
    return figures


def _changed(image: Any, background: Any) -> Iterator[tuple[str, Any]]:
    image, whole = np.asarray(image, np.float64), np.asarray(background, np.float64)
    noise = np.random.default_rng(0).normal(0, 1, image.shape)
    torn = image.copy()
    torn[image.shape[0] // 2 :] = whole.mean()
    columns = np.linspace(0.85, 1.15, image.shape[1])[None, :, None]
    for kind, one in (
        ("as it is", image),
        ("1.06 times", 1.06 * image),
        ("1.2 times", 1.2 * image),
        (".6 times", 0.6 * image),
        ("bluer", image * (0.9, 1, 1.15)),
        ("uneven", image * columns),
        ("room light", image + 12),
        ("moved", np.roll(image, (2, 3), (0, 1))),
        ("blurred", (image + np.roll(image, 1, 0) + np.roll(image, 2, 0)) / 3),
        ("noisy", image + 4 * noise),
        ("torn", torn),
        ("turned", image[::-1, ::-1]),
        ("mirrored", image[:, ::-1]),
        ("clipped", np.minimum(image, np.quantile(image, 0.9)) * 255 / np.quantile(image, 0.9)),
    ):
        yield kind, np.clip(np.rint(one), 0, 255).astype(np.uint8)


def dots(shared: dict[str, bytes]) -> Figures:
    """Dots of three gels, found and followed."""
    import gelform
    from gelform.image.markers import MarkerTracker

    figures: Figures = {}
    videos = {"mini-markers-video": DATA / "mini-markers-video" / "mini_example.avi"}
    videos |= {name: DATA / "slip" / "clips" / f"{name}.avi" for name in ("tennis_ball_1", "lemon_1")}
    for name, path in videos.items():
        seen = [frame.image for frame in gelform.Video(path).frames()]
        rest = np.mean(seen[:10], axis=0).astype(np.float32)
        found = gelform.markers_from_image(rest)
        figures[f"{name} markers"] = len(found)
        if not len(found):
            continue
        figures[f"{name} radius"] = float(np.median(found.radius_px))
        tracker = MarkerTracker(rest, mm_per_px=0.0634)
        for k, image in enumerate(seen[: len(seen) // 2 + 20 : 4]):
            flow = tracker.update(image)
            if flow is not None and k % 4 == 0:
                figures[f"{name} {k} seen"] = int(flow.seen.sum())
                figures[f"{name} {k} shift"] = float(np.abs(flow.displacement_px[flow.seen]).mean())
                figures[f"{name} {k} sigma"] = float(np.median(flow.sigma_px))
    rest = pickle.loads(shared["gelslim-dots"]).background
    found = gelform.markers_from_image(rest)
    figures["gelslim-dots markers"] = len(found)
    figures["mini-ball markers"] = len(
        gelform.markers_from_image(pickle.loads(shared["mini-ball"]).background)
    )
    reconstruct = gelform.Reconstructor(pickle.loads(shared["gelslim-dots"]))
    for k, press in enumerate(pressed("gelslim-dots").presses[1::4]):
        figures |= _of_result(reconstruct(press.image), f"gelslim-dots {k}")
    return figures


def motion(shared: dict[str, bytes]) -> Figures:
    """Motions between presses of a ball and of a cube's edge, along a grasp with dots, and the surface of three frames."""
    import gelform
    from edges_of_cube import frames as of_cube
    from gelform.calibration.starters import load_starter
    from motion.clips import frames_of, results_of
    from presses import mini_ball

    figures: Figures = {}
    background, images = of_cube()
    starter = load_starter("gelsight-mini").for_unit(background.astype(np.float32), mm_per_px=0.0634)
    of_balls, of_edges = (
        gelform.Reconstructor(pickle.loads(shared["mini-ball"])),
        gelform.Reconstructor(starter),
    )
    balls = [press for press in mini_ball()[0].presses if press.ball_diameter_mm < 7][3:40:5]
    seen = [of_balls.from_image(press.image) for press in balls]
    for k, (a, b, one, other) in enumerate(zip(seen, seen[1:], balls, balls[1:])):
        start = np.eye(4)
        start[:2, 3] = (np.array(other.label[:2]) - one.label[:2]) * 0.0634
        figures |= _of_motion(gelform.motion_between(a, b, start=start), f"ball {k}")
    edges = [of_edges.from_image(image) for image in list(images.values())[:6]]
    for k, (a, b) in enumerate(pairwise(edges)):
        figures |= _of_motion(gelform.motion_between(a, b), f"cube {k}")
    firsts = {
        path.stem: next(frames_of(path.stem)) for path in sorted((DATA / "slip" / "clips").glob("*.avi"))
    }
    results = results_of("tennis_ball_1", firsts, every=8)[:16]
    tracked = list(gelform.track(results))
    for k, one in enumerate(tracked):
        figures |= _of_motion(one.motion, f"grasp {k}")
    surface = gelform.mosaic(results, tracked)
    figures |= {
        "mosaic depth": float(surface.depth_mm.max()),
        "mosaic contact": int(surface.contact.sum()),
        "mosaic sigma": float(np.median(surface.depth_sigma_mm[surface.contact])),
    }
    for k in range(0, len(results) - 4, 3):
        figures |= _of_motion(gelform.motion_between(results[k], results[k + 4]), f"grasp pair {k}")
    return figures


def _of_motion(found: Any, key: str) -> Figures:
    figures: Figures = {f"{key} state": found.state, f"{key} blind": len(found.blind)}
    if found.pose is not None:
        figures[f"{key} shift"] = float(np.linalg.norm(found.pose[:3, 3]))
        figures[f"{key} turn"] = float(np.linalg.norm(found.pose[:3, :3] - np.eye(3)))
        figures[f"{key} sigma"] = float(np.sqrt(np.trace(found.covariance)))
    return figures


def force(shared: dict[str, bytes]) -> Figures:
    """Newtons of touches of a gripper, and shear of dots: calibrated on a half, told of the other."""
    import gelform
    from gelform.depth.force import Load

    found, figures = pickle.loads(shared["loads"]), {}
    model = gelform.calibrate_force(found.touches[::2], found.loads[::2])
    figures |= _of_force(gelform.evaluate_force(model, found.touches[1::2], found.loads[1::2]), "wedge")
    recordings = []
    for k in (0, 1):
        with np.load(DATA / "force-dots" / f"recording-{k}.npz") as file:
            rest, moved, newtons, torque = (
                file[n] for n in ("rest_mm", "displacement_mm", "force_n", "torque")
            )
        touches = [gelform.touch_from_dots(rest, one) for one in moved[::5]]
        loads = [
            Load(f"recording {k}", shear_n=(float(x), float(y)), torsion_n_mm=1e3 * float(t))
            for (x, y, _), (_, _, t) in zip(newtons[::5], torque[::5])
        ]
        recordings.append((touches, loads))
    model = gelform.calibrate_force(*recordings[0])
    figures |= _of_force(gelform.evaluate_force(model, *recordings[1]), "dots")
    return figures


def _of_force(found: Any, key: str) -> Figures:
    figures: Figures = {}
    for part, rows in found.items():
        if isinstance(rows, list) and rows:
            for name in ("presses", "refused", "mae", "within_1", "within_2"):
                figures[f"{key} {part} {name}"] = rows[-1].get(name)
    return figures


def streams(shared: dict[str, bytes]) -> Figures:
    """Clips of a real unit from rest on, and a simulated sensor with each fault: when each finding came first."""
    import gelform
    from gelform.calibration.starters import load_starter
    from gelform.reconstruct import Reconstructor
    from gelform.sensors.streams.memory import Memory
    from stream.sensor_faults import FAULTS, Gel, found_in, frames_with

    figures: Figures = {}
    calibration, sensor = pickle.loads(shared["simulated"]), _small()
    for fault in (None, *FAULTS):
        rng = np.random.default_rng(5)
        gel = Gel.drawn(sensor, rng)
        first = found_in(frames_with(fault, gel, 60, rng), gel.calibration(calibration, rng))
        figures[f"simulated {fault} findings"] = str(sorted(first.items()))
    for path in sorted((DATA / "mini-octopi").rglob("*.*4"))[::21]:
        seen = [frame.image for frame in gelform.Video(path).frames()][:50]
        rest = np.mean(seen[:3], axis=0).astype(np.float32)
        starter = load_starter("gelsight-mini").for_unit(rest, mm_per_px=0.0634)
        memory = Memory(Reconstructor(starter))
        for k, image in enumerate(seen[::2]):
            result = memory(image, memory.result_from_image(image))
            if k % 6 == 0:
                figures |= _of_result(result, f"{path.stem} {k}")
    return figures


def circles(shared: dict[str, bytes]) -> Figures:
    """Circles of presses, found and moved to agree with one model."""
    from gelform.calibration.circles.find import prepare, with_contacts
    from gelform.calibration.circles.locate import refine

    figures: Figures = {}
    for name, count in (("mini-ball", 8), ("homemade-even/a", 8), ("gelslim-dots", 6), ("mini-d", 6)):
        refined = refine(with_contacts(prepare(pressed(name, count))))
        figures[f"{name} used"] = sum(reason is None for reason in refined.reasons)
        for key in ("x_px", "y_px", "radius_px"):
            figures[f"{name} {key}"] = float(np.mean([getattr(one, key) for one in refined.contacts]))
    return figures


def presses(shared: dict[str, bytes]) -> Figures:
    """Presses used, and the errors on held-out presses, of a calibration by few presses."""
    import gelform

    figures: Figures = {}
    for name in REFINED:
        report = gelform.calibrate(pressed(name)).report
        figures |= {
            f"{name} used": sum(press.accepted for press in report.presses),
            f"{name} degrees": report.held_out.get("normal_free_deg"),
            f"{name} radius": report.held_out.get("radius_percent"),
        }
    return figures


PARTS: dict[str, Callable[[dict[str, bytes]], Figures]] = {
    "force": force,
    "light": light,
    "dots": dots,
    "frames": frames,
    "circles": circles,
    "streams": streams,
    "motion": motion,
    "presses": presses,
}
# The parts whose trials take ten seconds and more are for the numbers of one room, and for those that no other part reaches.
ROOMS = {"circles": "calibration", "streams": "sensors", "motion": "motion", "presses": "calibration"}


def parts_of(room: str, reached: bool = True) -> list[str]:
    """The parts that a room's numbers are tried on, the quick ones first; all of them if none `reached` the number."""
    return [part for part in PARTS if not reached or part not in ROOMS or ROOMS[part] in room.split("/")]


def figures_of(part: str, shared: dict[str, bytes]) -> Figures:
    """All figures of a part; the name of an error in their place where there is one."""
    try:
        return PARTS[part](shared)
    except Exception as problem:  # a trial may make the work impossible, which is its figure
        said = str(problem).replace(f"{DATA}{os.sep}", "")  # a record holds no path of a machine
        return {"part error": f"{type(problem).__name__}: {said}"[:80]}
