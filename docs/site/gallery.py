"""The gallery: what each command draws, made by running it on a simulated sensor."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

SETS = (
    "simulate -o presses --count 12 --seed 1",
    "simulate -o relief --height-map letters.npy --height-map-mm-per-px 0.02 --depth-mm 0.35",
    "calibrate presses -o cal.npz --model hierarchical",
    "calibrate presses -o other.npz --model lambertian",
)
DRAWN = (  # command, the picture it leaves, what one sees
    (
        "simulate -o relief --height-map letters.npy --height-map-mm-per-px 0.02 --depth-mm 0.35",
        "relief/image.png",
        "An image of a simulated sensor: raised letters. Beside it the exact truth of every pixel.",
    ),
    (
        "reconstruct relief/image.png -c cal.npz -o out --format npz,png",
        "out/image.png",
        "Image, normals, slopes, depth in mm, profiles through the deepest point.",
    ),
    (
        "explain spoiled.png -c cal.npz -o why",
        "why/spoiled.png",
        "How far each pixel was trusted, and why. A highlight and a hair were drawn into the image.",
    ),
    (
        "compare relief/image.png -c cal.npz -c other.npz -o side-by-side",
        "side-by-side/image.png",
        "Two calibrations of one sensor: depth, difference, profile. Here the second is of the ideal model.",
    ),
    (
        "design three-edges --presses 6 -o design.png",
        "design.png",
        "A sensor's lights before it is built, and variations of them: the depth error that each would give.",
    ),
)


def write_gallery(folder: Path, *, run: bool = True) -> None:
    """gallery.md and its pictures in a folder; without `run` the page says only which command draws what."""
    lines = [
        "# Gallery",
        "",
        "What the commands draw, on a simulated sensor; this page is made by running them.",
        "",
    ]
    pictures = _pictures(folder / "images" / "gallery") if run else {}
    for command, _, said in DRAWN:
        name = command.split()[0]
        lines += [f"## {name}", "", said, "", "```sh", f"gelform {command}", "```", ""]
        if name in pictures:
            lines += [f"![gelform {name}](images/gallery/{pictures[name]})", ""]
    lines += ["## calibrate", "", "The [report](calibration-report.md) of `gelform calibrate --report`.", ""]
    lines += ["![The report](images/report.png)", ""]
    lines += [
        "## live",
        "",
        "[The live page](live.md) in the browser.",
        "",
        "![live](images/live/desktop-light.jpg)",
        "",
    ]
    (folder / "gallery.md").write_text("\n".join(lines), encoding="utf-8")


def _pictures(folder: Path) -> dict[str, str]:
    """Runs the commands; names of the pictures by command."""
    import cv2
    import numpy as np

    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as work:
        drawing = np.zeros((300, 500), np.uint8)
        cv2.putText(drawing, "GEL", (60, 210), cv2.FONT_HERSHEY_SIMPLEX, 6, 255, 22, cv2.LINE_AA)
        np.save(Path(work, "letters.npy"), cv2.GaussianBlur(drawing, (0, 0), 3) * (0.4 / 255))  # mm
        for command in SETS:
            _run(command, work)
        spoiled = cv2.imread(f"{work}/relief/image.png")
        cv2.circle(spoiled, (90, 60), 9, (255, 255, 255), -1, cv2.LINE_AA)
        cv2.line(spoiled, (200, 40), (260, 190), (8, 8, 8), 3, cv2.LINE_AA)
        cv2.imwrite(f"{work}/spoiled.png", spoiled)
        for command, _, _ in DRAWN[1:]:
            _run(command, work)
        found = {}
        for command, picture, _ in DRAWN:
            name = command.split()[0]
            (folder / f"{name}.png").write_bytes(Path(work, picture).read_bytes())
            found[name] = f"{name}.png"
    return found


def _run(command: str, work: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "gelform", *command.split(), "--quiet"],
        cwd=work, env=os.environ, capture_output=True, text=True,
    )  # fmt: skip
    if done.returncode:
        raise SystemExit(f"gelform {command}: {done.stderr}")
