"""Whether a calibration's own statements are right: sigma, slope gain, few presses, repeated frames, a second unit.

    python benchmarks/trust.py                    # about 10 minutes; writes results/trust.json
    python benchmarks/trust.py sigma gain

All but `second_unit` read real presses (mini-ball below GELFORM_DATA, default ../shared/data). Without them they
are left out, with a message. Every judged press is new to the calibration.
"""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

import gelform
from gelform.calibration.report import report_content
from gelform.image.frame import pixels_digest
from gelform.result.metrics import angle_deg, score_slopes
from gelform.simulate import LAYOUTS, SimulatedSensor, simulate_ball_presses
from presses import DATA, data_is_missing, mini_ball, presses_of, unlabeled
from report import command_line, parts_asked, recorded, table, write

SLOPES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
SCORED_ZONE = 0.8  # fraction of the contact radius: beyond it the gel leaves the ball
PLACES = (3, 4)


class Bench:
    """mini-ball, its circles for scoring, and the two ways to calibrate on half of it."""

    def __init__(self) -> None:
        self.presses, self.order = mini_ball()
        self._halves: list[tuple[gelform.Calibration, list[int]]] = []

    def calibrated(self, training: list[int]) -> gelform.Calibration:
        """A calibration without labeled circles."""
        return gelform.calibrate(unlabeled(self.presses, training))

    def halves(self) -> list[tuple[gelform.Calibration, list[int]]]:
        """Each half calibrates once, and the other is judged."""
        if not self._halves:
            even, odd = self.order[0::2], self.order[1::2]
            self._halves = [(self.calibrated(a), b) for a, b in ((even, odd), (odd, even))]
        return self._halves

    def others(self, training: list[int]) -> list[int]:
        """The presses outside the training."""
        return [i for i in self.order if i not in set(training)]


def sigma(bench: Bench) -> dict[str, Any]:
    """Share of slopes within one sigma on held-out presses: by slope, by place, at rest (68 % is right)."""
    figures: dict[str, Any] = {}
    for name, (calibration, test) in zip(("even -> odd", "odd -> even"), bench.halves()):
        inside = [_slopes(bench, calibration, i) for i in test]
        pixels = np.concatenate([p for p, _ in inside])
        within = pixels[:, 2:4]
        slope = np.digitize(pixels[:, 4], SLOPES)
        height, width = calibration.image_shape
        cell = (pixels[:, 1] * PLACES[0] / height).astype(int) * PLACES[1]
        cell += (pixels[:, 0] * PLACES[1] / width).astype(int)
        figures[name] = {
            "all": float(within.mean()),
            "by slope": {f"{b / 10:g}-": float(within[slope == b].mean()) for b in np.unique(slope)},
            "by place": [float(within[cell == c].mean()) for c in np.unique(cell)],
            "at rest": float(np.nanmean([rest for _, rest in inside])),
        }
        row = figures[name]
        print(f"\n{name}: {100 * row['all']:.0f} % within one sigma, at rest {100 * row['at rest']:.0f} %")
        print("  by slope: " + ", ".join(f"{k} {100 * v:.0f} %" for k, v in row["by slope"].items()))
        print("  by place: " + ", ".join(f"{100 * v:.0f} %" for v in row["by place"]))
    return figures


def _slopes(bench: Bench, calibration: gelform.Calibration, index: int) -> tuple[np.ndarray, float]:
    """x, y, within sigma (p, q), |g| of the pixels in the scored zone; share within sigma far away."""
    press = bench.presses.presses[index]
    result = gelform.Reconstructor(calibration).from_image(press.image)
    cx, cy, contact = press.label
    y, x = np.mgrid[: result.depth_mm.shape[0], : result.depth_mm.shape[1]]
    rho = np.hypot(x - cx, y - cy)
    zone = rho < SCORED_ZONE * contact
    radius = press.ball_diameter_mm / 2 / calibration.mm_per_px
    score = score_slopes(result.gradients[zone], x[zone], y[zone], (cx, cy), radius)
    within = np.abs(score.errors) < result.gradients_sigma[zone]
    far = rho > 3 * contact
    rest = (np.abs(result.gradients[far]) < result.gradients_sigma[far]).mean() if far.any() else np.nan
    slope = np.linalg.norm(result.gradients[zone], axis=-1)
    return np.column_stack([x[zone], y[zone], within, slope]), float(rest)


def gain(bench: Bench) -> dict[str, Any]:
    """Recovered over true slope by slope bin, and whether a monotone correction improves held-out presses."""
    figures: dict[str, Any] = {}
    for name, (calibration, test) in zip(("even -> odd", "odd -> even"), bench.halves()):
        found = [_true_and_found(bench, calibration, i) for i in test]
        true, recovered = (np.concatenate([pair[k] for pair in found]) for k in (0, 1))
        bins = np.digitize(np.linalg.norm(true, axis=1), SLOPES)
        gains = {f"{b / 10:g}-": _gain(true[bins == b], recovered[bins == b]) for b in np.unique(bins)}
        figures[name] = {"gain": gains, "correction": _correction(calibration)}
        print(f"\n{name}: gain by true slope " + ", ".join(f"{k} {v:.3f}" for k, v in gains.items()))
        print("  a correction changes the normal error of held-out presses by "
              "{mean_deg:+.3f} +- {standard_error_deg:.3f} degrees".format(**figures[name]["correction"]))  # fmt: skip
    return figures


def _true_and_found(
    bench: Bench, calibration: gelform.Calibration, index: int
) -> tuple[np.ndarray, np.ndarray]:
    press = bench.presses.presses[index]
    gradients = gelform.Reconstructor(calibration).from_image(press.image).gradients
    cx, cy, contact = press.label
    y, x = np.mgrid[: gradients.shape[0], : gradients.shape[1]]
    zone = np.hypot(x - cx, y - cy) < SCORED_ZONE * contact
    radius = press.ball_diameter_mm / 2 / calibration.mm_per_px
    score = score_slopes(gradients[zone], x[zone], y[zone], (cx, cy), radius)
    return score.true_gradients, gradients[zone]


def _gain(true: np.ndarray, recovered: np.ndarray) -> float:
    return float((true * recovered).sum() / (true * true).sum())


def _correction(calibration: gelform.Calibration) -> dict[str, float]:
    """A curve |g| -> |g| / gain, fitted to four fifths of the held-out presses and judged on the rest."""
    samples = [s.within(1.0) for s in calibration.report.samples]
    change = []
    for k, sample in enumerate(samples):
        others = [
            s.within(calibration.settings["contact_radius_ratio"])
            for j, s in enumerate(samples)
            if j % 5 != k % 5
        ]
        true, recovered = (
            np.concatenate([getattr(s, a) for s in others]) for a in ("true_gradients", "gradients")
        )
        size = np.linalg.norm(true, axis=1)
        edges = np.quantile(size, np.linspace(0, 1, 9))
        bins = np.clip(np.digitize(size, edges[1:-1]), 0, 7)
        gains = np.array([_gain(true[bins == b], recovered[bins == b]) for b in range(8)])
        measured = np.maximum.accumulate(gains * np.array([size[bins == b].mean() for b in range(8)]))
        factor = np.interp(np.linalg.norm(sample.gradients, axis=1), measured, 1 / gains)[:, None]
        errors = [
            angle_deg(g, sample.true_gradients).mean() for g in (sample.gradients, factor * sample.gradients)
        ]
        change.append(errors[1] - errors[0])
    return {
        "mean_deg": float(np.mean(change)),
        "standard_error_deg": float(np.std(change, ddof=1) / np.sqrt(len(change))),
    }


def few(bench: Bench) -> dict[str, Any]:
    """Normal error and radius of the other presses after calibration on few: random draws, model chosen by auto."""
    figures: dict[str, Any] = {}
    for count in (10, 20):
        rows = []
        for seed in range(4):
            drawn = np.random.default_rng(seed).permutation(len(bench.order))[:count]
            training = [bench.order[k] for k in sorted(drawn)]
            calibration = bench.calibrated(training)
            test = bench.presses.subset(bench.others(training)[::2])
            rows.append(gelform.evaluate(calibration, test).summary)
        keys = ("normal_free_deg", "radius_percent", "cap_free_um", "off_contact_um")
        figures[str(count)] = {key: [row[key] for row in rows] for key in keys}
        means = {key: float(np.mean(values)) for key, values in figures[str(count)].items()}
        print(f"\n{count} presses, mean of {len(rows)} draws: " + json.dumps(means))
    return figures


def repeated(bench: Bench) -> dict[str, Any]:
    """Five presses, and six frames of each: verdict, held-out error, and error on the other presses."""
    figures: dict[str, Any] = {}
    for seed in range(3):
        rng = np.random.default_rng(seed)
        training = [int(i) for i in rng.permutation(bench.order)[:5]]
        alone = unlabeled(bench.presses, training)
        frames = tuple(_frame(press, rng) for press in alone.presses for _ in range(6))
        test = bench.presses.subset(bench.others(training)[::3])
        for name, some in (("5 presses", alone), ("30 frames of them", replace(alone, presses=frames))):
            calibration = gelform.calibrate(some, start=None)  # the starter has seen these presses
            verdict = report_content(some, calibration, rng=rng)["verdict"]["headline"]
            errors = [calibration.held_out, gelform.evaluate(calibration, test).summary]
            found = [errors_of["normal_free_deg"] for errors_of in errors]
            figures[f"{seed}: {name}"] = {
                "verdict": verdict,
                "held_out_deg": found[0],
                "others_deg": found[1],
            }
            print(f"{seed}: {name}: held out {found[0]:.2f}, others {found[1]:.2f} degrees. {verdict}")
    return figures


def _frame(press: Any, rng: np.random.Generator) -> Any:
    """Another frame of a press that is held: moved by up to half a pixel, with camera noise."""
    height, width = press.image.shape[:2]
    move = np.array([[1, 0, rng.uniform(-0.5, 0.5)], [0, 1, rng.uniform(-0.5, 0.5)]])
    image = cv2.warpAffine(
        press.image.astype(np.float32), move, (width, height), borderMode=cv2.BORDER_REFLECT
    )
    image = np.clip(np.rint(image + rng.normal(0, 1.5, image.shape)), 0, 255).astype(np.uint8)
    return replace(press, image=image, digest=pixels_digest(image))


def second_unit(_: Bench | None) -> dict[str, Any]:
    """Another unit of a simulated sensor, with LEDs displaced by 2 mm (sd) and up to 30 % brighter or dimmer."""
    first = replace(LAYOUTS["three-edges"], shape=(132, 176), mm_per_px=0.1153)
    figures: dict[str, Any] = {}
    for seed in (5, 6, 7):
        rng = np.random.default_rng(seed)
        leds = tuple(
            replace(
                led,
                position_mm=tuple(np.array(led.position_mm) + rng.normal(0, 2, 3) * (1, 1, 0.5)),
                color=tuple(np.array(led.color) * rng.uniform(0.7, 1.3)),
            )
            for led in first.leds
        )
        unit = replace(first, leds=leds, name="second unit")
        taught = gelform.calibrate(_presses(first, 30, 1), color_model="hierarchical")
        many, five, test = (_presses(unit, n, seed + s) for n, s in ((30, 10), (5, 20), (12, 30)))
        calibrations = {
            "its own 30 presses": gelform.calibrate(many, color_model="hierarchical"),
            "the first unit's, as it is": replace(taught, background=test.background),
            "the first unit's and 5 presses": gelform.calibrate(five, start=taught),
            "5 presses alone": gelform.calibrate(five, color_model="hierarchical"),
        }
        figures[str(seed)] = {
            name: gelform.evaluate(calibration, test).summary for name, calibration in calibrations.items()
        }
        keys = ("normal_free_deg", "cap_free_um", "radius_percent")
        rows = [[name, *(row[key] for key in keys)] for name, row in figures[str(seed)].items()]
        print("\n" + table([f"second unit {seed}", *keys], rows))
    return figures


def _presses(sensor: SimulatedSensor, count: int, seed: int) -> Any:
    made = simulate_ball_presses(
        sensor, ball_diameters_mm=[5.0, 8.0], count=count, rng=np.random.default_rng(seed)
    )
    return presses_of(made)


PARTS = {"sigma": sigma, "gain": gain, "few": few, "repeated": repeated, "second_unit": second_unit}


def main() -> None:
    """Run the named parts, or all; keep the earlier figures of the others."""
    asked = parts_asked(command_line(__doc__), PARTS)
    figures = recorded("trust")
    bench = Bench() if DATA.is_dir() else None
    for name in asked.parts:
        if name != "second_unit" and data_is_missing(name):
            continue
        figures[name] = PARTS[name](bench)  # type: ignore[operator]
        write("trust", figures)


if __name__ == "__main__":
    main()
