"""Parts of real_frames.py: the number of contacts in frames of one object, and in frames without contact."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

import gelform
from edges_of_cube import another_light
from presses import DATA
from real_frames.sets import MINI_MM_PER_PX, MINIS, Run, background_of, percent
from report import table

OBJECTS = ("bead", "key", "seed")
TWO_EDGES = "12.png"  # the frame of mini-edge that a second edge is in
UNTOUCHED = range(
    20, 55
)  # frames of mini-markers-video in which nothing touches the gel; a finger does from 55 on
NOISY = 20  # frames with noise for each background image
FAINT = (0.06, 0.12)  # shares of a press that is blended with the background image
PHANTOM_RADII = 2.0  # of a ball's circle; contact beyond is none of the ball
SEED = 20261125


def contacts(run: Run) -> dict[str, Any]:
    """Contacts found in frames of one ball, by each set's own calibration on all presses; of one edge; of objects."""
    figures: dict[str, Any] = {"balls": {}, "faint": {}, "objects": {}}
    rng = np.random.default_rng(SEED)
    for name in run.sets:
        reconstruct = gelform.Reconstructor(run.calibration(name))
        chosen = run.some(list(zip(run.presses(name).presses, run.circles(name))))
        results = (reconstruct.from_image(press.image) for press, _ in chosen)
        figures["balls"][name] = counted(results, [circle for _, circle in chosen])
        for share in FAINT:
            faint = (blended(reconstruct.calibration, press.image, share, rng) for press, _ in chosen)
            found = counted(map(reconstruct.from_image, faint), [circle for _, circle in chosen])
            figures["faint"][f"{name}, {100 * share:.0f} %"] = found
        if name == "digit-ball":
            paths = sorted((DATA / name / "deeper").glob("*.png"))
            figures["balls"][f"{name}/deeper"] = counted(
                reconstruct.from_image(gelform.read_image(path)) for path in paths
            )
    reconstruct = gelform.Reconstructor(run.carried("starter", background_of("mini-edge")))
    paths = sorted((DATA / "mini-edge" / "images").glob("*.png"))
    paths = run.some([path for path in paths if path.name != TWO_EDGES])
    images = [gelform.read_image(path) for path in paths]
    same_light = [one for one in images if not another_light(one, reconstruct.background)]
    for what, chosen in (("all frames", images), ("those in its light", same_light)):
        figures["balls"][f"mini-edge by the starter, {what}"] = counted(map(reconstruct.from_image, chosen))
    print("\n" + table(["contacts", *HEADER], [[k, *v.values()] for k, v in figures["balls"].items()]))
    rows = [[k, *v.values()] for k, v in figures["faint"].items()]
    print("\n" + table(["presses blended with the background", *HEADER], rows))
    for by, calibration in _for_objects(run).items():
        reconstruct = gelform.Reconstructor(calibration)
        images = [gelform.read_image(DATA / "mini-objects" / f"{one}.png") for one in OBJECTS]
        figures["objects"][by] = {
            one: len(reconstruct.from_image(image).contacts) for one, image in zip(OBJECTS, images)
        }
    rows = [[by, *counts.values()] for by, counts in figures["objects"].items()]
    print("\n" + table(["contacts of objects", *OBJECTS], rows), flush=True)
    return figures


HEADER = (
    "frames",
    "exactly one %",
    "none %",
    "extra, mean",
    "deepest <= 0",
    "one, on the ball %",
    "radius over circle",
    "beyond two radii %",
)


def counted(results: Iterable[Any], circles: Sequence[Any] = ()) -> dict[str, Any]:
    """Figures of frames in which one object touches the gel.

    `one, on the ball` are the frames whose only contact has the center of the ball's circle in it. `radius over circle` is
    the median radius of the largest contact's area over that of the visible circle: the gel leaves a ball inside of it.
    `beyond two radii` is the part of all contact further from the ball's center. They are None without circles.
    """
    counts, negative, on_ball, ratios, areas = [], 0, [], [], []
    for k, result in enumerate(results):
        found = result.contacts
        counts.append(len(found))
        negative += sum(one.deepest_mm is not None and one.deepest_mm <= 0 for one in found)
        circle = circles[k] if len(circles) else None
        if circle is not None and all(0 <= c < n - 0.5 for c, n in zip(circle[1::-1], result.shape)):
            at = result.contact_labels[round(circle[1]), round(circle[0])]
            on_ball.append(len(found) == 1 and at == found[0].label)
            y, x = np.nonzero(result.contact_labels)
            beyond = np.hypot(x - circle[0], y - circle[1]) > PHANTOM_RADII * circle[2]
            areas.append((np.count_nonzero(beyond), len(beyond)))
            if found and not found[0].cut_by_border:
                ratios.append(np.sqrt(found[0].area_px / np.pi) / circle[2])
    number = np.array(counts)
    figures = [
        len(number),
        percent(number == 1),
        percent(number == 0),
        float(np.maximum(number - 1, 0).mean()),
        negative,
        percent(on_ball) if on_ball else None,
        float(np.median(ratios)) if ratios else None,
        float(100 * np.sum(areas, axis=0)[0] / max(np.sum(areas, axis=0)[1], 1)) if areas else None,
    ]
    return dict(zip(HEADER, figures))


def _for_objects(run: Run) -> dict[str, gelform.Calibration]:
    """Calibrations for the unit of mini-objects: the Mini starter, and a network that another package trained on it."""
    background = background_of("mini-objects")
    known = {"by the starter": run.carried("starter", background)}
    if find_spec("torch") is None:
        print('\nby its own network: left out, no torch: pip install "gelform[torch]"')
        return known
    network = DATA / "peer-calibrations" / "gs_sdk-mini-c-nnmodel.pth"
    imported = gelform.import_calibration(
        network, package="gs_sdk", background=background, mm_per_px=MINI_MM_PER_PX
    )
    return {**known, "by its own network (imported)": imported}


def rest(run: Run) -> dict[str, Any]:
    """Frames without contact in which one is found: backgrounds with camera noise, and a video at rest."""
    figures: dict[str, Any] = {}
    known = {name: run.calibration(name) for name in run.sets}
    known |= {name: run.carried("starter", background_of(name)) for name in MINIS}
    for name, calibration in known.items():
        rng, count = np.random.default_rng(SEED), run.frames(NOISY)
        figures[f"{name}, background and noise"] = frames_with_contact(
            calibration, [with_noise(calibration, rng) for _ in range(count)]
        )
    figures[f"mini-markers-video, frames {UNTOUCHED[0]}-{UNTOUCHED[-1]}"] = _video(run)
    rows = [[name, *row.values()] for name, row in figures.items()]
    print("\n" + table(["without contact", *REST_COUNTS, "%"], rows), flush=True)
    return figures


def blended(
    calibration: gelform.Calibration, image: np.ndarray, share: float, rng: np.random.Generator
) -> np.ndarray:
    """A press that is as faint as that share of it, with as much of the camera's noise as an image has."""
    rest = calibration.background
    noise = rng.normal(size=rest.shape) * np.array(calibration.settings.image_noise) * np.sqrt(1 - share**2)
    return np.clip(np.rint(rest + share * (image - rest) + noise), 0, 255).astype(np.uint8)


def with_noise(calibration: gelform.Calibration, rng: np.random.Generator) -> np.ndarray:
    """A calibration's background image with the noise of its camera, rounded to gray levels."""
    noise = rng.normal(size=calibration.background.shape) * np.array(calibration.settings.image_noise)
    return np.clip(np.rint(calibration.background + noise), 0, 255).astype(np.uint8)


def _video(run: Run) -> dict[str, float]:
    """The untouched frames of a video: the median of every second one is the background image of the others."""
    frames = gelform.Video(DATA / "mini-markers-video" / "mini_example.avi").frames(set(UNTOUCHED))
    images, figures = [one.image for one in frames], []
    for k in (0, 1):
        background = np.median(images[k::2], axis=0).astype(np.float32)
        figures.append(frames_with_contact(run.carried("starter", background), run.some(images[1 - k :: 2])))
    return _of_counts(*(int(sum(one[key] for one in figures)) for key in REST_COUNTS))


def frames_with_contact(calibration: gelform.Calibration, images: Sequence[np.ndarray]) -> dict[str, float]:
    """The number of frames, and of those in which a contact is found, or about which anything is said (but the starter)."""
    reconstruct = gelform.Reconstructor(calibration)
    results = [reconstruct.from_image(image) for image in images]
    found = sum(bool(one.contacts) for one in results)
    said = sum(bool(set(one.health) - set(reconstruct.findings)) for one in results)
    return _of_counts(len(images), found, said)


REST_COUNTS = ("frames", "with a contact", "with a finding")


def _of_counts(frames: int, found: int, said: int) -> dict[str, float]:
    return dict(zip(REST_COUNTS, (frames, found, said))) | {"percent": 100 * found / frames}
