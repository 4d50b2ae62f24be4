"""Whether two commits give the same, to the bit: maps, findings, files, and what commands print, on a fixed set.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/same.py --against REF    # lists what differs; 1 if any does
    python benchmarks/same.py -o before.json        # digests of this checkout, by name; three minutes

The set: every simulated layout; 40 frames of each real set where GELFORM_DATA is, read by a starter; one calibration. What
needs an extra that is missing here is left out for both. Times of day and durations do not count.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import hashlib
import io
import json
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import gelform
from gelform.batch.outputs.files import facts_of
from gelform.live import shown
from gelform.robots.ros_messages import RosMessages
from gelform.robots.topics import TOPICS
from presses import DATA
from report import command_line
from speed.against import KEPT, ROOT, built
from speed.against import digest as of_sources

FRAMES, DRAWN_EVERY = 40, 8  # of a real set; and which of them are also explained and drawn for the page
MINI, DIGIT = "gelsight-mini", "digit"
# Starter, mm per pixel, gel at rest, and images of a real set; a video's first frame is its gel at rest. Sets without a
# starter are read by that of mini-ball, in its size: their depth is wrong, but their faults are real.
REAL: dict[str, tuple[str, float, str, str]] = {
    "mini-ball": (MINI, 0.0634, "background.png", "*mm/*/*"),
    "mini-objects": (MINI, 0.0634, "background.png", "[bks]e*.png"),
    "mini-d": (MINI, 0.08, "background.png", "images/*"),
    "mini-edge": (MINI, 0.0634, "background.png", "images/*"),
    "digit-ball": (DIGIT, 0.05107, "background.png", "images/*"),
    "gelsight-ball-deep": ("", 0.05107, "background.png", "images/*"),
    "gelslim": ("", 0.0703, "background.png", "images/*"),
    "gelslim-dots": ("", 0.0703, "background.png", "images/*"),
    "homemade-even/a": ("", 0.01877, "background.jpg", "Im*"),
    "force-wedge": ("", 0.11905, "images/golf_ball-0/rest.png", "images/golf_ball-0/0*"),
    "mini-markers-video": (MINI, 0.0634, "", "mini_example.avi"),
    "slip": (MINI, 0.0634, "", "clips/avocado_real_*"),
}
# Commands in the order in which they use each other's files.
COMMANDS = """
simulate -o three-edges --sensor three-edges --count 2 --json | simulate -o ring-120 --sensor ring-120 --count 2
simulate -o gelsight-mini --sensor gelsight-mini --count 2 | simulate -o digit --sensor digit --count 2
simulate -o gelslim --sensor gelslim --count 2 | simulate -o first-build --sensor first-build --count 2
simulate -o balls --sensor homemade --count 8 --as video,mcap
simulate -o loads --sensor homemade --loads --count 16 --ball-diameter-mm 3 --ball-diameter-mm 9
info balls | info balls --json | info balls/images/0000.png | info balls/moving/moving.avi | info balls/moving/moving.mcap
calibrate balls -o cal.npz --report report --json | calibrate balls -o alone.npz --start none --verbose
starter simulated-three-edges --background three-edges/background.png -o unit.npz --json
info cal.npz | info cal.npz --json | info unit.npz | info loads --json
evaluate loads -c cal.npz | evaluate loads -c cal.npz --json
force calibrate loads -c cal.npz -o force.npz --json | force evaluate loads -c force.npz | info force.npz
reconstruct balls/images -c cal.npz -o out --format npz,png,ply,stl,tiff,x3p --json
reconstruct loads/images -c force.npz -o forces --json | reconstruct balls/images -c alone.npz -o again
reconstruct three-edges/images -c unit.npz -o starts | reconstruct balls/moving/moving.avi -c cal.npz -o film
reconstruct three-edges/images -c cal.npz -o wrong
info out/0000.npz | info out/0000.npz --json | info starts/0001.npz --json | info forces/0003.npz
explain balls/images -c cal.npz -o why --json | explain three-edges/images -c unit.npz
compare balls/images -c cal.npz -c alone.npz -o both --json | compare balls/images -c cal.npz -c alone.npz
batch loads/images -c force.npz -o levels --table csv --format png --json | verify levels --json
batch balls/moving/moving.mcap -c cal.npz -o kept --table csv --keep all | verify kept
track balls/moving/moving.avi -c cal.npz -o track.csv --surface surface.ply --json
export out/0000.npz --to png -o depth.png
export cal.npz --to taxim -o tables | export out/0001.npz --to stl -o solid.stl
"""
UNSCALED = (
    "reconstruct balls/images -c unscaled.npz -o flat --json",
    "info flat/0000.npz",
    "info unscaled.npz",
)
# What differs between two runs of one commit: times of day, durations, and SHA-256 of what holds them.
FLEETING = [
    (rb"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d:?\d\d)?", b"TIME"),
    (rb'("seconds": )[\d.]+|\bin [\d.]+ s\b|[\d.]+ frames/s, [\d:]+ left', rb"\1DURATION"),
    (rb"\b[0-9a-f]{64}\b", b"DIGEST"),
]


def main() -> None:
    """Print or write the digests of this checkout, or what differs from another commit's."""
    command = command_line(__doc__)
    command.add_argument("--against", metavar="REF", help="compare with a commit")
    command.add_argument(
        "-o", "--output", type=Path, metavar="JSON", help="write the digests of this checkout"
    )
    asked = command.parse_args()
    if asked.output:
        with tempfile.TemporaryDirectory() as folder:
            output = asked.output.resolve()
            os.chdir(folder)
            output.write_text(json.dumps(everything(), indent=1))
            os.chdir(ROOT)
    elif asked.against:
        old, new = both(built(asked.against), ROOT)
        lines = differences(old, new)
        print("\n".join([*lines, f"{len(lines)} of {len(old | new)} differ from {asked.against}."]))
        raise SystemExit(1 if lines else 0)
    else:
        command.error("give --against REF or -o JSON")


def both(*roots: Path) -> list[dict[str, str]]:
    """The digests by the sources in these folders, made at the same time by this script, or kept from before."""
    kept, own = [], of_sources(Path(__file__).parent, "same.py", "presses.py")
    around = f"{np.__version__}-{cv2.__version__}-{DATA.is_dir()}"
    KEPT.mkdir(exist_ok=True)
    runs = []
    for root in roots:
        kept.append(KEPT / f"same-{of_sources(root, 'src', 'native')}-{own}-{around}.json")
        if not kept[-1].is_file():
            command, path = [sys.executable, __file__, "-o", kept[-1]], {"PYTHONPATH": f"{root}/src"}
            runs.append(subprocess.Popen(command, env={**os.environ, **path}))
    if {run.wait() for run in runs} - {0}:
        raise SystemExit("A version ended early; see above.")
    return [json.loads(file.read_text()) for file in kept]


def differences(old: dict[str, str], new: dict[str, str]) -> list[str]:
    """The names that stand in one alone, or with other digests."""
    lines = [f"changed  {name}" for name in old if name in new and old[name] != new[name]]
    lines += [f"gone     {name}" for name in old if name not in new]
    return lines + [f"added    {name}" for name in new if name not in old]


def everything() -> dict[str, str]:
    """The digests of all, by name; makes files in the working folder."""
    found = {}
    for line in (part.split() for part in re.split(r"[|\n]", COMMANDS) if part.strip()):
        found |= of_command(line)
    replace(gelform.load_calibration("cal.npz"), mm_per_px=None).save("unscaled.npz")
    for line in UNSCALED:
        found |= of_command(line.split())
    for name, file in {"balls": "cal.npz", "loads": "force.npz"}.items():
        found |= of_frames(name, gelform.load_calibration(file), images(f"{name}/images/*"))
    mini: Any = None
    for name, (sensor, mm_per_px, rest, pattern) in REAL.items() if DATA.is_dir() else ():
        taken = images(f"{DATA}/{name}/{pattern}", None if sensor else mini.image_shape)
        background = (
            next(images(f"{DATA}/{name}/{rest}", None if sensor else mini.image_shape))
            if rest
            else next(taken)
        )
        if sensor:
            made = gelform.calibration_from_background(background, sensor=sensor, mm_per_px=mm_per_px)
            mini = mini or made
        else:
            made = replace(mini, background=background.astype(np.float32), mm_per_px=mm_per_px)
        made.save(file := Path(f"{name.replace('/', '-')}.npz"))
        found |= {f"{name}: calibration{part}": value for part, value in of_file(file)}
        found |= of_frames(name, made, taken)
    return found


def images(pattern: str, shape: tuple[int, int] | None = None) -> Iterator[np.ndarray]:
    """The first images with such a name, in order; of a video its first frames; resized if a shape (H, W) is given."""
    root, rest = ("/", pattern[1:]) if pattern.startswith("/") else (".", pattern)
    for path in sorted(Path(root).glob(rest))[: 1 if pattern.endswith((".avi", "real_*")) else FRAMES]:
        if path.suffix == ".avi":
            yield from (frame.image for frame in islice(gelform.Video(path), FRAMES))
        else:
            image = gelform.read_image(path)
            yield image if shape is None else cv2.resize(image, shape[::-1], interpolation=cv2.INTER_AREA)


def of_command(words: list[str]) -> dict[str, str]:
    """What a command prints, its exit status, and the files that it makes in this folder."""
    before = {path for path in Path().rglob("*") if path.is_file()}
    done = subprocess.run([sys.executable, "-m", "gelform", *words], capture_output=True)
    name = " ".join(words)
    found = {f"{name}: status": str(done.returncode)}
    found |= {f"{name}: {stream}": digest(lasting(getattr(done, stream))) for stream in ("stdout", "stderr")}
    made = {path for path in Path().rglob("*") if path.is_file() and path.suffix != ".mcap"} - before
    for path in sorted(made):  # a recording has the time when it was made, so its frames are read instead
        found |= {f"{name}: {path}{part}": value for part, value in of_file(path)}
    return found


def lasting(text: bytes) -> bytes:
    """Without what differs between two runs."""
    for pattern, instead in FLEETING:
        text = re.sub(pattern, instead, text)
    return text


def of_file(path: Path) -> Iterator[tuple[str, str]]:
    """Digests of a file, of an archive one for each member, whose times do not count."""
    if not zipfile.is_zipfile(path):
        yield "", digest(lasting(path.read_bytes()))
        return
    with zipfile.ZipFile(path) as archive:
        for member in archive.namelist():
            content = archive.read(member)
            if member == "meta.npy":
                content = str(np.load(io.BytesIO(content))).encode()  # text of 4 bytes a letter
            yield f", {member}", digest(lasting(content))


def of_frames(name: str, calibration: gelform.Calibration, taken: Iterable[np.ndarray]) -> dict[str, str]:
    """Digests of all that results of these images hold: one for each attribute, over all images."""
    totals: dict[str, Any] = {}
    reconstruct = gelform.Reconstructor(calibration)
    for number, image in enumerate(taken):
        parts = of_result(reconstruct, image) if number % DRAWN_EVERY else drawn(reconstruct, image)
        for part, value in parts:
            totals.setdefault(part, hashlib.sha256()).update(digest(value).encode())
    return {f"{name}: {part}": total.hexdigest()[:16] for part, total in totals.items()}


def of_result(reconstruct: gelform.Reconstructor, image: np.ndarray) -> Iterator[tuple[str, Any]]:
    """Name and value of each attribute of an image's result, and what a batch's table and the page say about it."""
    try:
        result = reconstruct.from_image(image)
    except gelform.GelformError as refusal:
        yield "refusals", str(refusal)
        return
    yield "in words", repr(result)
    yield "row of a batch", facts_of(result)
    lazy = {one.name for one in fields(result)}  # which are no attributes before their first use
    for name in sorted(lazy | {name for name in dir(result) if not name.startswith("_")}):
        try:
            value = getattr(result, name)
        except gelform.GelformError as refusal:
            value = str(refusal)
        if not callable(value):
            yield name, value


def drawn(reconstruct: gelform.Reconstructor, image: np.ndarray) -> Iterator[tuple[str, Any]]:
    """The same, with the explanation of the image, the views of a notebook and of the page."""
    yield from of_result(reconstruct, image)
    try:
        result, why = reconstruct.from_image(image), reconstruct.explain(image)
    except gelform.GelformError:
        return
    yield from ((f"explanation, {name}", values) for name, values in {**vars(why), **why.maps}.items())
    if result.depth_sigma_mm is not None and result.contact.any():
        yield "depth_difference_sigma", result.depth_difference_sigma()
    yield "notebook", result._repr_html_()
    measured = getattr(shown, "measures_of", None)  # only before `Reconstruction.numbers`
    more = {"measures": measured(result)} if measured else {}
    frame = gelform.Frame(image, 0.0, 0, 0)
    made = shown.ShownFrame if hasattr(shown, "ShownFrame") else shown.Shown  # its name before
    page = made(0, frame, image, result, explain=lambda: why, **more)
    yield "page", page.header()
    for topic in TOPICS if find_spec("rosbags") else ():
        yield f"ROS, {topic}", bytes(getattr(RosMessages("gel"), topic)(frame, result, 0) or b"")
    yield from ((f"page, {one.facts['name']}", vars(one)) for one in page.planes(shown.PLANES, "raw"))


def digest(value: Any) -> str:
    """Of a value's type and content, to the bit; TypeError for what has no content of its own."""
    sha = hashlib.sha256(type(value).__name__.encode())
    if isinstance(value, np.ndarray):
        sha.update(f"{value.dtype} {value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, bytes):
        sha.update(value)
    elif isinstance(value, str):
        sha.update(lasting(value.encode()))
    elif value is None or isinstance(value, (bool, int, float, np.generic)):
        sha.update(repr(value).encode())
    elif isinstance(value, (list, tuple)):
        sha.update("".join(map(digest, value)).encode())
    elif isinstance(value, Mapping):
        sha.update("".join(digest(key) + digest(one) for key, one in value.items()).encode())
    elif is_dataclass(value):
        return digest({one.name: getattr(value, one.name) for one in fields(value)})
    else:
        raise TypeError(f"Expected a value with a content of its own, got {type(value).__name__}.")
    return sha.hexdigest()[:16]


if __name__ == "__main__":
    main()
