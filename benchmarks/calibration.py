"""Color models on real presses: each model x each split of mini-ball, and the error by the number of presses.

    python benchmarks/calibration.py             # about 10 minutes; writes results/calibration.json and .png
    python benchmarks/calibration.py "10 presses" "half and half"

Circles are refined only on the calibrating presses of a split; errors are those of whole reconstructions of the other
presses. The data are in GELFORM_DATA (default ../shared/data).
"""

from __future__ import annotations

import sys
import time
from importlib.util import find_spec
from typing import Any

import numpy as np

import gelform
from gelform.calibration.circles.find import (
    ContactCircle,
    PreparedPress,
    prepare,
    prepared_with,
    training_samples,
    untouched_change,
)
from gelform.calibration.circles.locate import refine
from gelform.calibration.report.record import summary
from gelform.calibration.selection import Candidate, candidates_for
from gelform.result.metrics import press_errors
from gelform.slopes.color_models import COLOR_MODELS
from presses import DATA, by_name, reference_circles
from report import RESULTS, command_line, dct_pair, median_ms, recorded, table, write

PRESSES = 60  # what is tried with so many
TRAINED_WITH = {"mlp": "torch"}  # left out if it is not installed
MODELS = {
    candidate.describe(): candidate
    for name in COLOR_MODELS
    if name not in TRAINED_WITH or find_spec(TRAINED_WITH[name])
    for candidate in candidates_for(name, PRESSES)
}
# They take seconds for a fit or a frame: measured on one split, without a frame rate.
SLOW = [name for name, candidate in MODELS.items() if candidate.model in ("mlp", "interpolation")]
COUNTS = (10, 20, 50)
FIGURES = ("normal_free_deg", "radius_percent", "radius_signed_percent", "cap_free_um", "off_contact_um")


class Bench:
    """mini-ball, prepared once for each offset of the division, and the circles for scoring."""

    def __init__(self) -> None:
        self.presses = gelform.read_presses(DATA / "mini-ball")
        prepared = prepare(self.presses)
        self.prepared = {offset: prepared_with(self.presses, prepared, offset) for offset in (10.0, 0.0)}
        circles = reference_circles()
        self.circles = [circles[press.name] for press in self.presses.presses]
        self.order = by_name(self.presses)

    def splits(self) -> dict[str, tuple[list[int], list[int]]]:
        """Presses for calibration and for the test."""
        small = [i for i in self.order if self.presses.presses[i].ball_diameter_mm < 8]
        large = [i for i in self.order if self.presses.presses[i].ball_diameter_mm > 8]
        splits = {
            "half and half": (self.order[0::2], self.order[1::2]),
            "6.31 -> 9.50 mm": (small, large),
            "9.50 -> 6.31 mm": (large, small),
        }
        for count in COUNTS:
            chosen = np.random.default_rng(count).permutation(len(self.order))[:count]
            training = [self.order[k] for k in sorted(chosen)]
            splits[f"{count} presses"] = (training, [i for i in self.order if i not in set(training)])
        return splits

    def refined(self, training: list[int]) -> tuple[list[int], list[ContactCircle]]:
        """The presses that fit, and their circles."""
        refined = refine([self.prepared[10.0][i] for i in training])
        return [training[k] for k in refined.accepted], [refined.contacts[k] for k in refined.accepted]

    def errors(
        self, candidate: Candidate, training: list[int], contacts: list[ContactCircle], test: list[int]
    ) -> dict[str, float]:
        """The figures of a model on the test presses, and the seconds of its fit."""
        prepared = self.prepared[candidate.change_offset]
        used = [prepared[i] for i in training]
        start = time.perf_counter()
        model = candidate.fit(training_samples(used, contacts))
        seconds = time.perf_counter() - start
        ready = model.prepare(self.presses.background, self.presses.image_shape)
        threshold = untouched_change(used, contacts)
        errors = [self._press_errors(ready, prepared[i], i, threshold) for i in test]
        return {**summary(errors), "fit_s": seconds}

    def _press_errors(self, ready: Any, press: PreparedPress, index: int, threshold: float) -> Any:
        gradients = np.array(ready.gradients_from_color(press.color_change)[0])
        common = np.median(press.color_change.reshape(-1, 3), axis=0)
        untouched = np.linalg.norm(press.color_change - common, axis=-1) < threshold
        gradients -= np.median(gradients[untouched], axis=0)
        pitch = self.presses.mm_per_px
        depth = gelform.depth_from_gradients(gradients, mm_per_px=pitch, zero=untouched)
        radius = self.presses.presses[index].ball_diameter_mm / 2
        return press_errors(
            depth, gradients, circle_px=self.circles[index], ball_radius_mm=radius, mm_per_px=pitch
        )

    def speed(self) -> dict[str, float]:
        """Time of a frame with each model, relative to D, a bare DCT pair of the same size, one thread."""
        training, contacts = self.refined(self.order[0::2])
        shape = self.presses.image_shape
        calls = [dct_pair(shape)]
        names = [name for name in MODELS if name not in SLOW]
        for name in names:
            prepared = self.prepared[MODELS[name].change_offset]
            fitted = MODELS[name].fit(training_samples([prepared[i] for i in training], contacts))
            ready = fitted.prepare(self.presses.background, shape)
            calls.append(lambda r=ready, c=prepared[0].color_change: r.gradients_from_color(c))
        times = median_ms(calls)
        return {name: t / times[0] for name, t in zip(names, times[1:])}


def picture(figures: dict[str, dict[str, dict[str, float]]]) -> None:
    """Normal error by the number of calibrating presses, a line per model; models of a kind share the dashes."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    for k, name in enumerate(name for name in MODELS if name not in SLOW):
        values = [figures[f"{count} presses"][name]["normal_free_deg"] for count in COUNTS]
        dashes = {"polynomial": "--", "hierarchical": "-"}.get(name.split()[0], ":")
        axes.plot(COUNTS, values, f"o{dashes}", color=f"C{k % 10}", label=name, markersize=4)
    axes.set(xlabel="presses that calibrate", ylabel="normal error of the others, degrees", ylim=(0, 14))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1, 0.5))
    figure.savefig(RESULTS / "calibration.png", dpi=100)


def main() -> None:
    """Run the named splits, or all and the speed; keep the earlier figures of the others."""
    command = command_line(__doc__)
    command.add_argument("splits", nargs="*", metavar="SPLIT", help="names of splits; all by default")
    wanted = command.parse_args().splits
    if not DATA.is_dir():
        sys.exit(f"No data in {DATA}: set GELFORM_DATA.")
    bench = Bench()
    content = {"splits": {}} | recorded("calibration")
    splits = bench.splits()
    if unknown := [name for name in wanted if name not in splits]:
        command.error(f"no split {', '.join(unknown)}: expected {', '.join(splits)}")
    for split in wanted or splits:
        used, contacts = bench.refined(splits[split][0])
        content["splits"][split] = {
            name: bench.errors(candidate, used, contacts, splits[split][1])
            for name, candidate in MODELS.items()
            if name not in SLOW or split == "half and half"
        }
        rows = [
            [name, *(e[key] for key in FIGURES), e["fit_s"]] for name, e in content["splits"][split].items()
        ]
        print("\n" + table([f"{split} ({len(used)} used)", *FIGURES, "fit_s"], rows), flush=True)
        write("calibration", content)
    if not wanted:
        content["frame_in_dct_pairs"] = bench.speed()
        print("\n" + table(["a frame", "D"], list(content["frame_in_dct_pairs"].items())))
        write("calibration", content)
    if all(f"{count} presses" in content["splits"] for count in COUNTS):
        picture(content["splits"])


if __name__ == "__main__":
    main()
