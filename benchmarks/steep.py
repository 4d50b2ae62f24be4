"""Whether slopes and depths are unsure where presses of balls have shown nothing like them, and how sure balls stay.

    python benchmarks/steep.py             # about 6 minutes; writes results/steep.json
    python benchmarks/steep.py walls       # one part: walls, few

`walls`: heights of simulated objects with walls. `few`: another unit's model after no, 3, 5 and 12 presses of real data
(GELFORM_DATA, default ../shared/data), without the doubt of carried models, with its share, and with all of it. The faces
of a cube's edge, slopes beyond those of the training, and the depth of balls are in real_frames.py.
"""

from __future__ import annotations

from typing import Any
from unittest.mock import PropertyMock, patch

import numpy as np

import gelform
from accuracy.heights import DRAWN, drawn_sensor
from accuracy.objects import OBJECTS, height_of, usual_presses
from accuracy.real import EDGES
from gelform.calibration.presses.press_set import Presses
from gelform.simulate import LAYOUTS
from gelform.simulate.presets import gelsight_mini
from presses import data_is_missing, presses_of, unlabeled
from real_frames.beyond import CARRIED, INNER, distance, slopes_inside
from real_frames.edges import SURE
from real_frames.sets import Run
from report import command_line, parts_asked, recorded, table, write

SIZES, DRAWS = (3, 5, 12), 3
WALLS = ("screw", "punch 6 mm", "punch 2 mm")
SHARES = ("within 1 sigma", "within 2 sigma", "sure", "sure in 0.6")


def of_balls(
    calibration: gelform.Calibration, presses: Presses, edge: float, steeper: float = 0.0
) -> dict[str, float]:
    """Shares (percent) of the slopes inside the edge of labeled presses, of those that are truly steeper than a limit."""
    reconstruct, rows = gelform.Reconstructor(calibration), []
    for press in presses.presses:
        result = reconstruct.from_image(press.image)
        true, off, inside = slopes_inside(press, result, edge)
        sure = result.confidence[inside] > SURE
        inner = distance(result, press.label[:2])[inside] < INNER * press.label[2]
        columns = [(off < k).mean(axis=1) for k in (1, 2)] + [sure, np.where(inner, sure, np.nan)]
        rows.append(np.stack(columns, axis=-1)[np.linalg.norm(true, axis=1) >= steeper])
    columns = np.concatenate(rows).T
    known = [one[np.isfinite(one)] for one in columns]
    return {name: float(100 * one.mean()) if one.size else np.nan for name, one in zip(SHARES, known)}


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
    """Slopes that a carried model doubts, after few presses of this unit: with none of the doubt, its share, all of it."""
    run, found = Run(), {}
    for source, name in CARRIED:
        presses, rng = run.labeled(name), np.random.default_rng(0)
        unit = run.carried(source, presses.background, presses.mm_per_px)
        for _ in range(DRAWS):
            order = rng.permutation(len(presses.presses)).tolist()
            judging = presses.subset(order[-len(order) // 3 :])
            for size in (0, *SIZES):
                begun = unit if not size else gelform.calibrate(unlabeled(presses, order[:size]), start=unit)
                assert begun.slope_sigma is not None
                for share in dict.fromkeys((0.0, begun.carried, 1.0)):
                    with patch.object(gelform.Calibration, "carried", PropertyMock(return_value=share)):
                        row = of_balls(begun, judging, EDGES[name], begun.slope_sigma.shown[0])
                    found.setdefault(f"{name}, {size} presses, share {share:.2g}", []).append(row)
    return {
        name: {key: float(np.mean([one[key] for one in rows])) for key in rows[0]}
        for name, rows in found.items()
    }


PARTS = {"walls": walls, "few": few}


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
