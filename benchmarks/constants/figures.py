"""Figures of the reduced sets: real presses, a simulated sensor, degraded images. Runs in a process of its own."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

TRAINING, POOL, TEST, DRAWS = 12, 24, 3, 3  # presses; from 12 on the default color model is fitted
SIMULATED, DEGRADED = "simulated", "degraded"
SEED = 411  # of the simulated sensor, which chose no constant
Figures = dict[str, float]


def all_sets() -> tuple[str, ...]:
    """Names of the sets: the real ones last but for the first."""
    from accuracy.real import EDGES
    from presses import DATA

    first, *others = EDGES if DATA.is_dir() else [""]
    return tuple(name for name in (first, SIMULATED, DEGRADED, *others) if name)


def make_sets(folder: Path, sets: Sequence[str]) -> None:
    """Write the presses of sets into a folder, as these processes read them."""
    import gelform
    from accuracy.heights import drawn_sensor
    from accuracy.objects import OBJECTS
    from degraded import CHANGES
    from gelform.simulate import simulate_ball_presses, simulate_press
    from presses import DATA, labeled, mini_ball, presses_of, unlabeled

    for name in (one for one in sets if one not in (SIMULATED, DEGRADED)):
        whole = mini_ball()[0] if name == "mini-ball" else gelform.read_presses(DATA / name)
        order = np.random.default_rng(SEED).permutation(len(whole.presses)).tolist()
        presses = labeled(whole.subset(order[: TEST + POOL]))
        others = range(TEST, len(presses.presses))
        chosen = [np.random.default_rng(k).permutation(others)[:TRAINING].tolist() for k in range(DRAWS)]
        draws, test = [unlabeled(presses, sorted(one)) for one in chosen], range(TEST)
        _write(folder / name, (draws, presses.subset(test)))
    sensor = drawn_sensor(SEED)
    draws = [
        presses_of(
            simulate_ball_presses(
                sensor, ball_diameters_mm=[4.0, 6.0], count=TRAINING, rng=np.random.default_rng(SEED + k)
            )
        )
        for k in range(DRAWS)
    ]
    objects = [
        (press.image, press.depth_mm, press.gradients, press.contact)
        for indenter, depths in OBJECTS.values()
        for press in [simulate_press(sensor, indenter, depth_mm=depths[1], rng=np.random.default_rng(SEED))]
    ]
    _write(folder / SIMULATED, (draws, objects))
    spoiled = [
        [(change(image), *truth) for image, *truth in objects[k % 2 :: 4]]
        for k, change in enumerate(CHANGES.values())
    ]
    torn = [(np.roll(image, 40, axis=1), *truth) for image, *truth in objects[:1]]
    torn[0][0][:60] = objects[0][0][:60]
    _write(folder / DEGRADED, (draws, [*[one for part in spoiled for one in part], *torn]))


def calibration_of(folder: Path, name: str, draw: int) -> Any:
    """The calibration of one draw of presses, kept beside them; that of the simulated sensor for degraded images."""
    import gelform

    name = SIMULATED if name == DEGRADED else name
    kept = folder / f"{name}-{draw}.npz"
    if not kept.exists():
        gelform.calibrate(_read(folder / name)[0][draw]).save(kept)
    return gelform.load_calibration(kept)


def figures(folder: Path, name: str, draw: int, anew: bool = False) -> Figures:
    """Of a set, by the calibration that is there or one made anew; a calibration that fails has the figure 'failed'."""
    import gelform

    try:
        calibration = (
            gelform.calibrate(_read(folder / name)[0][draw]) if anew else calibration_of(folder, name, draw)
        )
    except gelform.GelformError:
        return {"failed": 1.0}
    test = _read(folder / name)[1]
    reconstruct = gelform.Reconstructor(calibration)
    found = (
        [_of_object(reconstruct, *one) for one in test]
        if name in (SIMULATED, DEGRADED)
        else [_of_press(name, calibration, reconstruct, press) for press in test.presses]
    )
    mean = {key: float(np.nanmean([one[key] for one in found])) for key in found[0]}
    held_out = {
        f"held out {key}": float(v) for key, v in calibration.held_out.items() if isinstance(v, float)
    }
    return {"failed": 0.0, "presses": float(calibration.settings["presses"]), **mean, **held_out}


def _of_press(name: str, calibration: Any, reconstruct: Any, press: Any) -> Figures:
    from accuracy.real import EDGES, SCORED_ZONE, scored

    result = reconstruct.from_image(press.image)
    pitch = calibration.known_mm_per_px
    errors = scored((press, result), press.label, pitch, EDGES[name])
    y, x = np.mgrid[: result.shape[0], : result.shape[1]]
    away, ball_px = np.hypot(x - press.label[0], y - press.label[1]), press.ball_diameter_mm / 2 / pitch
    inner = away < SCORED_ZONE * min(press.label[2], ball_px)
    truth = np.stack([press.label[0] - x, press.label[1] - y], axis=-1)[inner]
    truth = truth / np.sqrt(ball_px**2 - away[inner] ** 2)[:, None]
    within = np.abs(result.gradients[inner] - truth) < result.gradients_sigma[inner]
    overlap = _overlap(result.contact, away < press.label[2])
    return {
        **errors,
        "slopes within sigma": float(within.mean()),
        "contact overlap": overlap,
        **_stated(result),
    }


def _of_object(reconstruct: Any, image: Any, depth_mm: Any, gradients: Any, contact: Any) -> Figures:
    result = reconstruct.from_image(image)
    error = 1e3 * (result.depth_mm - depth_mm)
    return {
        "in contact um": float(np.sqrt(np.mean(error[contact] ** 2))),
        "off contact um": float(np.sqrt(np.mean(error[~contact] ** 2))),
        "slopes within sigma": float((np.abs(result.gradients - gradients) < result.gradients_sigma).mean()),
        "depth within sigma": float((np.abs(error) < 1e3 * result.depth_sigma_mm).mean()),
        "contact overlap": _overlap(result.contact, contact),
        **_stated(result),
    }


def _stated(result: Any) -> Figures:
    return {
        "confidence": float(result.confidence.mean()),
        "known": float(result.known.mean()),
        "depth sigma um": float(1e3 * np.nanmedian(result.depth_sigma_mm)),
        "findings": float(len(result.health)),
        "contacts": float(len(result.contacts)),
    }


def _overlap(found: Any, true: Any) -> float:
    return float((found & true).sum() / max(1, (found | true).sum()))


def _write(path: Path, content: Any) -> None:
    path.write_bytes(pickle.dumps(content))


def _read(path: Path) -> Any:
    return pickle.loads(path.read_bytes())
