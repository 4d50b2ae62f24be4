"""Whether slopes and depths are unsure where presses of balls have shown nothing like them, and how sure balls stay.

    python benchmarks/steep.py             # about 10 minutes; writes results/steep.json
    python benchmarks/steep.py edges       # one part: edges, beyond, caps, walls, few

`edges`: the faces of a cube's edge (mini-edge) by the models of other units. `beyond`: calibrations that were trained below
a slope, on steeper pixels of presses that are new to them. `caps`: depths of balls. `walls`: heights of simulated objects
with walls. `few`: another unit's model after no, 3, 5 and 12 presses, without and with the doubt of carried models. All but
`walls` read real data (GELFORM_DATA, default ../shared/data).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np

import gelform
from accuracy.heights import DRAWN, drawn_sensor
from accuracy.objects import OBJECTS, height_of, usual_presses
from accuracy.real import EDGES, STEEPEST
from edges_of_cube import Edge, crest_error_mm, edge_in, frames
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.held_out.measure import HeldOutSample
from gelform.confidence import SteepSlopes
from gelform.metrics import score_slopes
from gelform.metrics.ball import ball_center
from gelform.simulate import LAYOUTS
from gelform.simulate.presets import gelsight_mini
from gelform.starters import load_starter
from gelform.starters.starter import starter_from_calibration
from presses import DATA, data_is_missing, labeled, mini_ball, presses_of, unlabeled
from report import command_line, parts_asked, recorded, table, write
from starters.make import real_unit

SURE, INNER = 0.3, 0.6  # confidence over which a slope counts as sure; share of the visible circle
LIMITS = 0.4, 0.5  # slopes below which a calibration is trained
SIZES, DRAWS = (3, 5, 12), 3
SETS = ("mini-ball", "mini-d", "digit-ball")
WALLS = ("screw", "punch 6 mm", "punch 2 mm")
SHARES = ("within 1 sigma", "within 2 sigma", "sure", "sure in 0.6")


def presses_with_circles(name: str) -> gelform.Presses:
    """A real set with the circles for scoring."""
    if name == "mini-ball":
        presses, order = mini_ball()
        return presses.subset(order)
    return labeled(real_unit(name))


def carried(
    calibration: gelform.Calibration, background: np.ndarray, mm_per_px: float
) -> gelform.Calibration:
    """The models of a unit for another unit of the make, with the differences that the shipped starter states."""
    made = load_starter("gelsight-mini")
    stated: Any = {"spread": made.spread, "color_variance": made.color_variance}
    starter = starter_from_calibration(calibration, "gelsight-mini", units=("one",), **stated)
    return starter.for_unit(background, mm_per_px=mm_per_px)


def edges() -> dict[str, Any]:
    """Slopes of the faces within 1 and 2 sigma across the edge, sure pixels, and the depth of the crest within 2 sigma."""
    background, images = frames()
    found, pitch = {}, gelform.read_presses(DATA / "mini-ball").mm_per_px
    models = {"the Mini starter": load_starter("gelsight-mini").for_unit(background)}
    for name in ("mini-ball", "mini-d"):
        own = gelform.calibrate(unlabeled(presses_with_circles(name)), start=None)
        models[f"{name}'s model"] = carried(own, background, pitch)
    for name, calibration in models.items():
        reconstruct, rows, crests = gelform.Reconstructor(calibration), [], []
        for image in images.values():
            result = reconstruct.from_image(image)
            edge = edge_in(result.gradients, calibration.known_mm_per_px)
            if edge is not None:
                rows.append(_face_slopes(edge, result))
                error = abs(crest_error_mm(edge, result.depth_mm, calibration.known_mm_per_px))
                crests.append([np.mean(error < 2 * result.depth_sigma_mm[edge.crest]), error])
        shares = dict(zip(SHARES, 100 * np.concatenate(rows).mean(axis=0)))
        crest = np.mean(crests, axis=0)
        found[name] = {
            "edges": len(rows),
            **shares,
            "crest within 2 sigma": 100 * crest[0],
            "crest off, mm": crest[1],
        }
    return found


def _face_slopes(edge: Edge, result: Any) -> np.ndarray:
    rows = []
    for face, true in zip(edge.faces, edge.true_gradients):
        error = np.abs((result.gradients[face] - true) @ edge.across)
        sigma = result.gradients_sigma[face][:, 0]
        rows.append(np.stack([error < sigma, error < 2 * sigma, result.confidence[face] > SURE], axis=-1))
    return np.concatenate(rows)


@contextmanager
def trained_below(limit: float) -> Iterator[None]:
    """Calibrations neither fit nor judge pixels whose true slope exceeds a limit."""
    radius, within = PreparedPress.contact_radius, HeldOutSample.within

    def near(press: PreparedPress, contact: Any) -> float:
        return min(radius(press, contact), float(np.sin(np.arctan(limit))) * press.ball_radius_px)

    def gentle(sample: HeldOutSample, zone: float) -> HeldOutSample:
        one = within(sample, zone)
        keep = np.linalg.norm(one.true_gradients, axis=1) < limit
        names = ("x_px", "y_px", "true_gradients", "gradients")
        return replace(one, **{name: getattr(one, name)[keep] for name in names})

    with patch.object(PreparedPress, "contact_radius", near), patch.object(HeldOutSample, "within", gentle):
        yield


def beyond() -> dict[str, Any]:
    """Every second press calibrates, once below a limit and once on all slopes; the others judge."""
    found = {}
    for name in SETS:
        presses = presses_with_circles(name)
        training, test = (range(first, len(presses.presses), 2) for first in (0, 1))
        judging = presses.subset(list(test))
        for limit in LIMITS:
            with trained_below(limit):
                calibration = gelform.calibrate(unlabeled(presses, training), start=None)
            found[f"{name}, steeper than {limit}"] = of_balls(calibration, judging, EDGES[name], limit)
        calibration = gelform.calibrate(unlabeled(presses, training), start=None)
        found[f"{name}, all slopes"] = of_balls(calibration, judging, EDGES[name])
    return found


def of_balls(
    calibration: gelform.Calibration, presses: gelform.Presses, edge: float, steeper: float = 0.0
) -> dict[str, float]:
    """Shares (percent) of the slopes inside the edge of labeled presses, of those that are truly steeper than a limit."""
    reconstruct, rows = gelform.Reconstructor(calibration, depth_sigma=False), []
    y, x = np.mgrid[: calibration.image_shape[0], : calibration.image_shape[1]]
    for press in presses.presses:
        result = reconstruct.from_image(press.image)
        column, row, radius = press.label
        ball_px = press.ball_diameter_mm / 2 / calibration.known_mm_per_px
        away = np.hypot(x - column, y - row)
        inside = away < min(edge * radius, STEEPEST * ball_px)
        score = score_slopes(result.gradients[inside], x[inside], y[inside], (column, row), ball_px)
        errors, sigma = np.abs(score.errors), result.gradients_sigma[inside]
        sure = result.confidence[inside] > SURE
        columns = [(errors < k * sigma).mean(axis=1) for k in (1, 2)]
        columns += [sure, np.where(away[inside] < INNER * radius, sure, np.nan)]
        rows.append(np.stack(columns, axis=-1)[np.linalg.norm(score.true_gradients, axis=1) >= steeper])
    columns = np.concatenate(rows).T
    known = [one[np.isfinite(one)] for one in columns]
    return {name: float(100 * one.mean()) if one.size else np.nan for name, one in zip(SHARES, known)}


def caps() -> dict[str, Any]:
    """Depth over balls against the cap: of one unit's halves, and by the other unit's model."""
    ball, other = (presses_with_circles(name) for name in ("mini-ball", "mini-d"))
    own = {
        name: gelform.calibrate(unlabeled(one), start=None) for name, one in (("ball", ball), ("d", other))
    }
    found = {}
    for name, presses in (("mini-ball", ball), ("mini-d", other)):
        for half, rest in ((0, 1), (1, 0)):
            picked, judging = (list(range(k, len(presses.presses), 2)) for k in (half, rest))
            calibration = gelform.calibrate(unlabeled(presses, picked), start=None)
            found[f"{name}, half {half}"] = _caps(calibration, presses.subset(judging), EDGES[name])
    by_ball = carried(own["ball"], other.background, other.mm_per_px)
    by_d = carried(own["d"], ball.background, ball.mm_per_px)
    found["mini-d by mini-ball's model"] = _caps(by_ball, other, EDGES["mini-d"])
    found["mini-ball by mini-d's model"] = _caps(by_d, ball, EDGES["mini-ball"])
    return found


def _caps(calibration: gelform.Calibration, presses: gelform.Presses, edge: float) -> dict[str, float]:
    reconstruct, rows, pitch = gelform.Reconstructor(calibration), [], calibration.known_mm_per_px
    y, x = np.mgrid[: calibration.image_shape[0], : calibration.image_shape[1]]
    for press in presses.presses:
        result = reconstruct.from_image(press.image)
        column, row, radius = press.label
        ball_px = press.ball_diameter_mm / 2 / pitch
        reach = min(edge * radius, STEEPEST * ball_px)
        near = np.hypot(x - column, y - row) < reach
        center = ball_center(result.gradients[near], x[near], y[near], (column, row), ball_px)
        away = np.hypot(x - center[0], y - center[1])
        error = result.depth_mm - pitch * np.sqrt(np.maximum(ball_px**2 - away**2, 0))
        inside, ring, top = away < reach, np.abs(away - reach) < 1.5, away < 0.2 * reach
        shape = np.abs(error - error[inside].mean())[inside]
        rise, sigma = abs(error[top].mean() - error[ring].mean()), result.depth_sigma_mm
        stated = result.depth_difference_sigma(inside)[inside]
        rows.append(
            [
                np.mean(shape < stated),
                np.mean(shape < sigma[inside]),
                rise < sigma[top].mean(),
                rise,
                sigma[top].mean(),
            ]
        )
    means = np.mean(rows, axis=0)
    names = "shape within 1 sigma of the difference", "shape within 1 sigma", "rise within 1 sigma"
    return {
        **dict(zip(names, 100 * means[:3])),
        "rise off, um": 1e3 * means[3],
        "sigma of the top, um": 1e3 * means[4],
    }


def walls() -> dict[str, Any]:
    """Heights of punches and screws within 2 sigma, on the four layouts and on four sensors that were drawn at random."""
    drawn = {f"drawn {seed}": drawn_sensor(seed) for seed in DRAWN}
    found = {}
    for name, sensor in {**LAYOUTS, "gelsight-mini": gelsight_mini(), **drawn}.items():
        reconstruct = gelform.Reconstructor(gelform.calibrate(presses_of(usual_presses(sensor, 30))))
        heights = [
            height_of(sensor, reconstruct, OBJECTS[what][0], d) for what in WALLS for d in OBJECTS[what][1]
        ]
        keys = {"height, %": "height_percent", "within 2 sigma": "within_2_sigma"}
        found[name] = {said: float(np.mean([one[key] for one in heights])) for said, key in keys.items()}
    mean = {
        key: float(np.mean([one[key] for one in found.values()])) for key in ("height, %", "within 2 sigma")
    }
    return {**found, "all": mean}


def few() -> dict[str, Any]:
    """Slopes beyond the median of shown ones, after few presses of this unit: without the doubt, and with all of it."""
    sets = {name: presses_with_circles(name) for name in ("mini-d", "mini-ball")}
    own = {name: gelform.calibrate(unlabeled(one), start=None) for name, one in sets.items()}
    found = {}
    for (name, presses), source in zip(sets.items(), ("mini-ball", "mini-d")):
        unit, rng = carried(own[source], presses.background, presses.mm_per_px), np.random.default_rng(0)
        for _ in range(DRAWS):
            order = rng.permutation(len(presses.presses)).tolist()
            judging = presses.subset(order[-len(order) // 3 :])
            for size in (0, *SIZES):
                begun = unit if not size else gelform.calibrate(unlabeled(presses, order[:size]), start=unit)
                assert begun.slope_sigma is not None
                middle = float(np.median(begun.slope_sigma.slopes))
                for share in (0.0, 1.0):
                    with patch(
                        "gelform.reconstruct.SteepSlopes", lambda sigma, own, s=share: SteepSlopes(sigma, s)
                    ):
                        row = of_balls(begun, judging, EDGES[name], middle)
                    found.setdefault(f"{name}, {size} presses, share {share:g}", []).append(row)
    return {
        name: {key: float(np.mean([one[key] for one in rows])) for key in rows[0]}
        for name, rows in found.items()
    }


PARTS = {"edges": edges, "beyond": beyond, "caps": caps, "walls": walls, "few": few}


def main() -> None:
    """Measure the named parts, or all."""
    results = recorded("steep")
    for name in parts_asked(command_line(__doc__), PARTS).parts:
        if name != "walls" and data_is_missing(name):
            continue
        found = results[name] = PARTS[name]()
        keys = list(dict.fromkeys(key for one in found.values() for key in one))
        rows = [[case, *(one.get(key, "") for key in keys)] for case, one in found.items()]
        print("\n" + table([name, *keys], rows), flush=True)
        write("steep", results)


if __name__ == "__main__":
    main()
