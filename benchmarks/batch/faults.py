"""Deliberate faults in a batch: killed processes, corrupt inputs, compressed video. See `batch.py`."""

from __future__ import annotations

import csv
import hashlib
import os
import shutil
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import gelform
from gelform.batch import BatchSettings, run_batch, verify_output

SETTINGS = BatchSettings("npz", keep=("depth",), part_frames=16)
DRIVER = """
import sys
from gelform.batch import Engine, run_batch
source, calibration, output, engine, here = sys.argv[1:]
sys.path.insert(0, here)
from batch.faults import SETTINGS
if __name__ == "__main__":
    run_batch(source, calibration, output, SETTINGS, engine=Engine(engine, 2), table="csv")
"""
OUTLIVE_S = 180  # s after which Ray's processes notice that their driver is gone
CODECS = [  # name of encoder, pixel format, options
    ("libsvtav1", "yuv420p", {"crf": "30", "g": "2"}),
    ("libsvtav1", "yuv420p", {"crf": "10", "g": "2"}),
    ("libx264", "yuv420p", {"crf": "23"}),
    ("libx264", "yuv444p", {"crf": "10"}),
    ("libx264rgb", "rgb24", {"crf": "0"}),
    ("mjpeg", "yuvj420p", {"qscale": "3"}),
]


def kills(folder: Path, rounds: int, engine: str = "pool") -> dict[str, Any]:
    """SIGKILL at random moments to a worker or the driver, then the same command: the bytes equal an undisturbed run's."""
    if engine == "ray" and find_spec("ray") is None:
        return {"engine": engine, "left out": "not installed"}
    (folder / "driver.py").write_text(DRIVER)
    rows, rng = [], np.random.default_rng(16)
    begin = time.monotonic()
    started(folder, folder / engine, engine).wait()
    usual_s, whole = time.monotonic() - begin, tree(folder / engine)
    for who in ("worker", "driver"):
        equal = killed = went_on = tried = 0
        for k in range(3 * rounds):  # a kill before a process exists, or after its end, hits nothing
            if killed == rounds:
                break
            output = folder / f"{engine}-{who}-{k}"
            done, hit = kill_once(folder, output, engine, who, rng.uniform(0, usual_s))
            killed, went_on = killed + hit, went_on + done
            again = started(folder, output, engine).wait() == 0
            equal += again and tree(output) == whole and verify_output(output)[2] == []
            shutil.rmtree(output)
            tried = k + 1
            print(
                f"  {engine}, {who}: {equal} of {tried} byte-equal, {killed} kills hit",
                file=sys.stderr,
                flush=True,
            )
        row = {"engine": engine, "killed": who, "moments": tried, "kills_that_hit": killed}
        rows.append({**row, "run_went_on_by_itself": went_on, "byte_equal": equal})
    return {"frames": len(list((folder / "in").rglob("*.png"))), "usual_s": usual_s, "rows": rows}


def started(folder: Path, output: Path, engine: str) -> subprocess.Popen[bytes]:
    """The same command each time."""
    arguments = [folder / "in", folder / "cal.npz", output, engine, Path(__file__).parents[1]]
    command = [sys.executable, folder / "driver.py", *arguments]
    return subprocess.Popen(list(map(str, command)), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def kill_once(folder: Path, output: Path, engine: str, who: str, after_s: float) -> tuple[bool, bool]:
    """Kill one process of a run; return whether the run still ended well, and whether there was a process to kill."""
    process = started(folder, output, engine)
    time.sleep(after_s)
    below = descendants(process.pid)
    marks = (b"spawn_main",) if engine == "pool" else (b"ray::_do", b"ray::IDLE")  # not Ray's own agents
    workers = [one for one in below if any(mark in command_of(one) for mark in marks)]
    victims = workers if who == "worker" else [process.pid]
    hit = process.poll() is None and bool(victims)
    if hit:
        os.kill(victims[int(after_s * 1e6) % len(victims)], signal.SIGKILL)
    ended_well = process.wait() == 0
    deadline = time.monotonic() + OUTLIVE_S
    while any(alive(one) for one in below) and time.monotonic() < deadline:
        time.sleep(0.05)
    left = [command_of(one).replace(b"\0", b" ")[-200:] for one in below if alive(one)]
    assert not left, f"processes outlived their driver by {OUTLIVE_S} s: {left}"
    return ended_well, hit


def descendants(number: int) -> list[int]:
    """Processes below one, as long as they are still its children."""
    try:
        tasks = Path(f"/proc/{number}/task").iterdir()
        children = [int(one) for task in tasks for one in (task / "children").read_text().split()]
    except OSError:
        return []
    return [*children, *(one for child in children for one in descendants(child))]


def command_of(number: int) -> bytes:
    """The command of a process, or its own title; empty if it has ended."""
    try:
        return Path(f"/proc/{number}/cmdline").read_bytes()
    except OSError:
        return b""


def alive(number: int) -> bool:
    """Whether a process runs; a zombie does not."""
    return bool(command_of(number))


def tree(output: Path) -> dict[str, str]:
    """Every file except leftovers, with its digest."""
    files = (path for path in output.rglob("*") if path.is_file() and not path.name.startswith("."))
    return {str(p.relative_to(output)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def corrupt(folder: Path, rounds: int) -> dict[str, Any]:
    """One image of a hundred truncated, of another size, empty, or a text: each gets its reason, the others are done."""
    images = sorted((folder / "in").rglob("*.png"))
    ways = {"truncated": "truncated", "size": "shape", "empty": "is empty", "text": "no image"}
    broken: dict[str, str] = {}
    for k, path in enumerate(images[::100]):
        way = list(ways)[k % 4]
        broken[path.stem] = way
        content = path.read_bytes()
        if way == "size":
            cv2.imwrite(str(path), np.zeros((48, 64, 3), np.uint8))
        else:
            path.write_bytes({"truncated": content[: len(content) // 2], "empty": b"", "text": b"no\n"}[way])
    summary = run_batch(folder / "in", folder / "cal.npz", folder / "out", SETTINGS, table="csv")
    with (folder / "out/frames.csv").open(newline="") as file:
        errors = {row["frame"]: row["error"] for row in csv.DictReader(file) if not row["output"]}
    found = {way: next(errors[stem] for stem in broken if broken[stem] == way) for way in ways}
    reasons = {way: said.replace(f"{folder}/", "") for way, said in found.items()}
    done = summary.frames - summary.errors
    exact = errors.keys() == broken.keys() and verify_output(folder / "out")[0] == done
    return {
        "frames": len(images),
        "corrupt": len(broken),
        "errors": len(errors),
        "done": done,
        "exact": exact,
    } | {"reasons": reasons}


def lossy(folder: Path, rounds: int) -> dict[str, Any]:
    """Depth from frames after video compression, compared with depth from the original frames."""
    import av

    reconstruct = gelform.Reconstructor(gelform.load_calibration(folder / "cal.npz"))
    frames = [gelform.read_image(path) for path in sorted((folder / "in").rglob("*.png"))]
    exact = [reconstruct.from_image(frame) for frame in frames]
    rows = []
    for codec, pixels, options in CODECS:
        path = folder / ("video.mkv" if codec == "mjpeg" else "video.mp4")
        with av.open(str(path), "w") as file:
            stream = file.add_stream(codec, rate=30, options=options)
            stream.height, stream.width, stream.pix_fmt = *frames[0].shape[:2], pixels
            for frame in frames:
                file.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
            file.mux(stream.encode())
        with av.open(str(path)) as file:
            decoded = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
        errors = []
        for image, truth in zip(decoded, exact, strict=True):
            difference = reconstruct.from_image(image).depth_mm - truth.depth_mm
            errors.append(1e3 * np.sqrt(np.mean(difference[truth.contact] ** 2)))
        label = f"{codec} {pixels} {' '.join(f'{name} {value}' for name, value in options.items())}"
        size = path.stat().st_size / 1e3 / len(frames)
        rows.append({"video": label, "depth_rms_um_in_contact": float(np.median(errors)), "kb_a_frame": size})
    return {"frames": len(frames), "rows": rows}
