"""Speed: every stage of a frame, and the whole frame, one thread, at three sizes and of mini-ball; and a calibration.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/speed.py    # three minutes; --quick: only 240x320, one
    python benchmarks/speed.py --against REF     # the same frames by a commit and by this checkout, in turn; two minutes

    python benchmarks/speed.py --large           # images of 2464x3280 px alone: time and memory; two minutes
    python benchmarks/speed.py --calls           # kernel calls of a frame, and their share of its time; half a minute

Machines are shared and noisy: times are of the processor, and ratios to D, a bare float32 scipy dctn + idctn pair of the
same size that is measured alternately with the stages in the same run, are to be trusted. Writes results/speed.json.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

import gelform
import gelform.depth.integrate
import gelform.reconstruct
from gelform.calibration.presses.press_set import Presses
from gelform.depth.contact import PreparedContact, contacts_from_mask
from gelform.depth.sigma import DepthErrors
from gelform.exchange.exporters.press_folder import save_press_folder
from gelform.simulate import LAYOUTS, Ball, simulate_ball_presses, simulate_press
from gelform.slopes.budget import ReadSlopes
from presses import DATA, by_name, unlabeled
from report import dct_pair, median_ms, recorded, table, write, write_part
from speed.against import compare
from speed.calls import kernel_calls
from speed.large import measured as large_images
from speed.turns import EVERYTHING as WHOLE
from speed.turns import first_frame_ms, read

SIZES = ((240, 320), (480, 640), (960, 1280))
EVERYTHING = "whole frame, everything on"  # all that a result can be asked for
ALONE = "whole frame, depth alone, multigrid"
FIRST_FRAMES = 5
PEERS = json.loads((Path(__file__).parent / "peers.json").read_text())


def calibration_at(shape: tuple[int, int]) -> tuple[gelform.Calibration, np.ndarray]:
    """A calibrated simulated sensor of that size, and an image of a press."""
    with tempfile.TemporaryDirectory() as folder:
        image = write_presses(Path(folder) / "presses", shape)
        presses = unlabeled(gelform.read_presses(Path(folder) / "presses"))
        return gelform.calibrate(presses, color_model="hierarchical"), image


def write_presses(folder: Path, shape: tuple[int, int]) -> np.ndarray:
    """Write presses of a simulated sensor of that size to a folder; the image of one more press."""
    small = replace(LAYOUTS["three-edges"], shape=(120, 160), mm_per_px=0.1268)
    made = simulate_ball_presses(
        small, ball_diameters_mm=[5.0, 8.0], count=24, rng=np.random.default_rng(0), oversample=1
    )
    more = simulate_press(small, Ball(3.0), depth_mm=0.6, rng=np.random.default_rng(1))
    images = [made.background, more.image, *(press.image for press in made.presses)]
    background, shown, *images = (cv2.resize(i, shape[::-1], interpolation=cv2.INTER_CUBIC) for i in images)
    save_press_folder(
        folder,
        background=background,
        images=images,
        ball_diameters_mm=[press.ball_diameter_mm for press in made.presses],
        mm_per_px=small.mm_per_px * small.shape[0] / shape[0],
        name="simulated",
    )
    return shown


def stages(calibration: gelform.Calibration, image: np.ndarray) -> dict[str, Callable[[], Any]]:
    """Each part of a frame with the arguments that it had in one; then whole frames, depth alone and with everything."""
    reconstruct = gelform.Reconstructor(calibration)
    today, fixed = reconstruct._today, reconstruct._calibrated
    parts = {
        "faults of the image": (today, "health"),
        "light": (today.untouched_image, "compare"),
        "clipped channels": (today, "clipped"),
        "color change, blur and color model": (today, "in_one_pass"),
        "depth of the frame, step of the forward response": (fixed, "stepped"),
        "untouched pixels": (gelform.reconstruct, "without_bias"),
        "weights": (ReadSlopes, "weights"),
        "anchor at rest": (fixed.depth, "_anchor"),
        "depth (weighted, anchored), curl": (gelform.depth.integrate.IntegrationProblem, "solved"),
        "slopes of the depth": (gelform.reconstruct, "slopes_of_solution"),
        "noise beyond the usual": (today, "noise_levels"),
        "budget of slopes, confidence": (today, "budget"),
        "errors of depth": (fixed, "depth_sigma"),
        "sigma of depth": (DepthErrors, "sigma"),
        "contact": (PreparedContact, "_contact"),
        "color around the contact": (today, "surround"),
    }
    calls: dict[str, Callable[[], Any]] = {}
    with ExitStack() as patched:
        for name, (holder, attribute) in parts.items():
            noted = noting(calls, name, getattr(holder, attribute))
            patched.enter_context(patch.object(holder, attribute, noted))
        result = reconstruct.from_image(image)
        read([result], WHOLE)
    return (
        {name: calls[name] for name in parts}
        | {
            "contacts": lambda: contacts_from_mask(
                result.contact, result.depth_mm, mm_per_px=result.mm_per_px
            )
        }
        | {ALONE: lambda: reconstruct.from_image(image).depth_mm}
        | {EVERYTHING: lambda: read([reconstruct.from_image(image)], WHOLE)}
    )


def noting(calls: dict[str, Callable[[], Any]], name: str, part: Callable[..., Any]) -> Callable[..., Any]:
    """The part, which also notes a call of itself with the same arguments; a result makes some of them read-only."""

    def noted(*args: Any, **kwargs: Any) -> Any:
        own = (one.copy() if isinstance(one, np.ndarray) else one for one in args)
        calls[name] = partial(part, *own, **kwargs)
        return part(*args, **kwargs)

    return noted


def against(ref: str, quick: bool) -> None:
    """Compare this checkout with a commit on frames: simulated, with dots, and of a Mini; quick: of a Mini alone."""
    with tempfile.TemporaryDirectory() as folder:
        presses = Path(folder) / "simulated"
        images = {presses: write_presses(presses, SIZES[0])}
        real = [DATA / name for name in ("gelslim-dots", "mini-ball") if (DATA / name).is_dir()]
        images |= {path: shown_press(gelform.read_presses(path)) for path in real}
        for presses, image in images.items():
            np.save(Path(folder) / f"{presses.name}.npy", image)
        frames = [(presses, Path(folder) / f"{presses.name}.npy") for presses in images]
        compare(ref, frames[-1:] if quick else frames, quick=quick)


def shown_press(presses: Presses) -> np.ndarray:
    """The press that is timed: the second by name, which a calibration on every third does not see."""
    return presses.presses[by_name(presses)[1]].image


def main() -> None:
    """Measure every size, and a real frame, and print the table."""
    parser = argparse.ArgumentParser(description="How fast every stage of a frame is.")
    parser.add_argument("--quick", action="store_true", help="simulated 240x320 alone; writes no results")
    parser.add_argument(
        "--against", metavar="REF", help="compare with a commit; --quick: whole frames alone, one"
    )
    parser.add_argument("--large", action="store_true", help="images of 2464x3280 px alone")
    parser.add_argument("--calls", action="store_true", help="kernel calls of a frame and their share alone")
    asked = parser.parse_args()
    if asked.against:
        against(asked.against, asked.quick)
        return
    if asked.large:
        with tempfile.TemporaryDirectory() as folder:
            write_presses(Path(folder), SIZES[0])
            large = large_images(Path(folder))
        print(large)
        write_part("speed", "large", large)
        return
    if asked.calls:
        calls = {"240x320": kernel_calls(*calibration_at(SIZES[0]))}
        if (DATA / "mini-ball").is_dir():
            presses = gelform.read_presses(DATA / "mini-ball")
            calls["mini-ball"] = kernel_calls(gelform.calibrate(presses), shown_press(presses))
        print(calls)
        write_part("speed", "calls", calls)
        return
    figures: dict[str, Any] = {}
    others: dict[str, Any] = {}
    for shape in SIZES[:1] if asked.quick else SIZES:
        calibration, image = calibration_at(shape)
        figures[f"{shape[0]}x{shape[1]}"] = timed_stages(calibration, image)
        if shape == SIZES[0]:
            with tempfile.TemporaryDirectory() as folder:
                calibration.save(file := Path(folder) / "cal.npz")
                np.save(shown := Path(folder) / "image.npy", image)
                others["first_frame_s"] = min(
                    first_frame_ms(file, shown)[0] / 1e3 for _ in range(FIRST_FRAMES)
                )
    if (DATA / "mini-ball").is_dir() and not asked.quick:
        presses = gelform.read_presses(DATA / "mini-ball")
        started = time.process_time()
        calibration = gelform.calibrate(presses)
        others["calibration_of_67_presses_cpu_s"] = time.process_time() - started
        figures["mini-ball"] = timed_stages(calibration, shown_press(presses))
    names = list(next(iter(figures.values())))[1:]
    rows: list[list[Any]] = [["bare DCT pair D", *(f"{f['D']:.2f} ms" for f in figures.values())]]
    rows += [[n, *(f"{f[n]['D']:.1f} D ({f[n]['ms']:.2f} ms)" for f in figures.values())] for n in names]
    print(table(["stage", *figures], rows))
    peer = next(iter(PEERS["frame_speed"].values()))["D"]
    over = {name: peer / figures["240x320"][name]["D"] for name in (ALONE, EVERYTHING)}
    faster = (f"{name}: {times:.1f} times faster" for name, times in over.items())
    print(f"gs_sdk's get_surface_info: {peer} D; {', '.join(faster)}\n{others}")
    if not asked.quick:
        kept = {name: one for name, one in recorded("speed").items() if name in ("large", "calls")}
        write("speed", {**kept, "sizes": figures, "times_faster_than_gs_sdk": over, **others})


def timed_stages(calibration: gelform.Calibration, image: np.ndarray) -> dict[str, Any]:
    """D, ms, and every stage in ms and D."""
    calls = stages(calibration, image)
    pair = dct_pair(calibration.image_shape)
    unit, *times = median_ms([pair, *calls.values()], rounds=101, seconds=15, clock=time.process_time)
    return {"D": unit, **{name: {"ms": ms, "D": ms / unit} for name, ms in zip(calls, times)}}


if __name__ == "__main__":
    main()
