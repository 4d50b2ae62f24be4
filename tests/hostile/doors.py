"""Right arguments of every public function, by their names; the tests replace one after the other with odd ones."""

from __future__ import annotations

import inspect
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import gelform
from gelform.calibration.starters import load_starter
from gelform.depth.contact import contacts_from_mask
from gelform.exchange.exporters.press_folder import save_press_folder
from gelform.exchange.plots import save_picture
from gelform.foundations.filters import fill_unknown
from gelform.image.background import ChangeSettings, image_from_color_change
from gelform.image.markers.follower import MarkerFollower
from gelform.image.view import Lens
from gelform.result.metrics import press_errors
from gelform.sensors.files import read_background
from made.images import grid, image_of_dots
from made.small_gel import LIGHTS, MM_PER_PX, SHAPE, Touch, background, calibration, depth_of, image_of

PLACE = tempfile.TemporaryDirectory(prefix="gelform-doors-")
FOLDER = Path(PLACE.name)
DEPTH = depth_of(Touch()).astype(np.float32)
GRADIENTS = gelform.gradients_from_depth(DEPTH, mm_per_px=MM_PER_PX)
NORMALS = gelform.normals_from_gradients(GRADIENTS)
IMAGE, REST, UNTOUCHED = image_of(Touch()), background(), image_of(None)
CHANGE = gelform.color_change_from_image(IMAGE, REST)
MASK = DEPTH > 0
WEIGHTS = np.where(MASK, 1.0, 0.5).astype(np.float32)
CALIBRATION = calibration()
RESULT = gelform.Reconstructor(CALIBRATION)(IMAGE)
ONE_PRESS = [None] * 9 + [Touch(depth_mm=depth) for depth in (0.1, 0.2, 0.3, *[0.4] * 20, 0.2)] + [None] * 9
FILM = [
    gelform.Frame(image_of(touch and replace(touch, seed=k)), k / 25, 0, k)
    for k, touch in enumerate(ONE_PRESS)
]
SCALE = gelform.Scale(0.1, 0.001, "two marks")
PLACES = [(x, y) for x in (22.0, 40.0, 58.0) for y in (22.0, 42.0)]
FOLDER_OF_PRESSES = {
    "background": UNTOUCHED, "images": [image_of(Touch(x_px=x, y_px=y, seed=int(x + y))) for x, y in PLACES],
    "ball_diameters_mm": [8.0] * 6, "centers_px": PLACES, "contact_radii_px": [17.4] * 6, "name": "known gel",
    "mm_per_px": MM_PER_PX,
}  # fmt: skip
PRESSES = save_press_folder(FOLDER / "presses", **FOLDER_OF_PRESSES)
GRID = image_of_dots(grid(40.0, (200, 240), 40.0), radii=8.0, shape=(200, 240))
LIT = [(UNTOUCHED * share).astype(np.uint8) for share in ([1, 0.1, 0], [0.1, 1, 0.1], [0, 0.1, 1])]
DOTS = np.array([[0.0, 0], [2, 0], [0, 2], [2, 2]])
TOUCHES = [gelform.touch_from_dots(DOTS, k * np.ones((4, 2))) for k in (0.1, 0.2, 0.5)]
LOADS = [gelform.Load("ball", shear_n=(k, k)) for k in (0.1, 0.2, 0.5)]
FORCE = gelform.calibrate_force(TOUCHES, LOADS)


def fresh_folder() -> Path:
    """Made anew for each call: nothing is written over."""
    return Path(tempfile.mkdtemp(dir=FOLDER))


# Of modules below gelform, beside its own names.
DEEPER = (
    ChangeSettings, contacts_from_mask, fill_unknown,
    image_from_color_change, Lens, MarkerFollower, press_errors, read_background, save_picture, save_press_folder,
)  # fmt: skip
# What no argument of a user's goes into: records of results, made by the functions, and a Protocol.
RECORDS = {
    "Calibration",
    "Contact",
    "ForceModel",
    "Integration",
    "Load",
    "Motion",
    "Reconstruction",
    "Stream",
    "Tracked",
}
EXPORTS: dict[str, Callable[..., Any]] = {one.__name__: one for one in DEEPER} | {
    name: getattr(gelform, name)
    for name in gelform.__all__
    if name not in RECORDS and not name.endswith("Error")
}
# Tried with nothing right at all: what is right is long to make, or a thread.
ALL_ODD = {"save_simulated_presses", "Grabber", "stream"}

# Right for whatever has an argument of this name; an argument without a line keeps its default, or is odd.
VALUES: dict[str, Any] = {
    "frame": IMAGE, "image": IMAGE, "background": REST, "color_change": CHANGE, "touched": MASK, "view": gelform.View(),
    "normals": NORMALS, "lights": LIGHTS, "albedo": WEIGHTS, "gradients": GRADIENTS, "texture": 0.02, "depth_mm": DEPTH,
    "mm_per_px": MM_PER_PX, "weights": WEIGHTS, "mask": MASK, "values": GRADIENTS, "known": MASK, "contact": MASK,
    "depth": DEPTH, "circle_px": (40.0, 30.0, 17.0), "ball_radius_mm": 4.0, "scales": [SCALE, SCALE], "scale": SCALE,
    "a_px": (3.0, 4.0), "b_px": (60.0, 50.0), "sigma_px": 0.5, "sigma_mm": 0.01, "first": IMAGE,
    "second": image_of(Touch(x_px=48)), "dark": UNTOUCHED // 99, "images": [GRID], "pattern": (5, 4), "pitch_mm": 1.0,
    "pitch_sigma_mm": 0.01, "gel_id": "g", "package": "gs_sdk", "sensor_name": "x", "path": "nowhere.npz",
    "paths": "nowhere.png", "spec": "nowhere", "ball_diameter_mm": 8.0, "calibration": CALIBRATION,
    "presses": gelform.read_presses(PRESSES), "crosstalk": gelform.crosstalk_from_frames(LIT),
    "a": RESULT, "b": RESULT, "results": [RESULT, RESULT],
    "poses": [np.eye(4), np.eye(4)], "prior": (0.1, 0.1), "result": RESULT, "model": FORCE, "loads": LOADS,
    "rest_mm": DOTS, "displacement_mm": 0.1 * DOTS, "picture": IMAGE, "overwrite": True,
}  # fmt: skip
OTHERS: dict[str, dict[str, Any]] = {
    "background_from_frames": {"frames": [IMAGE] * 3},
    "calibrate": {"color_model": "lambertian", "start": None},
    "calibrate_force": {"presses": TOUCHES, "sure_of_unit": True},
    "calibration_from_background": {
        "background": load_starter("gelsight-mini").calibration.background,
        "sensor": "gelsight-mini", "mm_per_px": 0.0634, "serial": "A",
    },
    "crosstalk_from_frames": {"frames": LIT, "response": 1.0},
    "depth_from_gradients": {"weights": None, "mask": None},
    "evaluate_force": {"presses": TOUCHES},
    "force_from_result": {"result": TOUCHES[0]},
    "ChangeSettings": {"crosstalk": None},
    "Frame": {"time_s": 0.0, "wall_time_ns": 0, "index": 0},
    "integrate": {"anchor": WEIGHTS, "zero": MASK},
    "Lens": {
        "camera": (80.0, 80.0, 40.0, 32.0), "distortion": (0.01, 0.0, 0.0, 0.0),
        "perspective": (1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0),
    },
    "lights_from_normals": {"image": np.maximum(NORMALS @ LIGHTS.T, 0)},
    "motion_between": {"start": np.eye(4)},
    "normals_from_image": {"image": NORMALS @ LIGHTS.T},
    "presses_from_frames": {"frames": FILM, "name": "x"},
    "read_loads": {"background": None},
    "read_presses": {"path": PRESSES, "sensor": None, "crop": None, "background": None},
    "Reconstructor": {"background": None},
    "save_picture": {"path": FOLDER / "picture.png"},
    "save_press_folder": {"folder": fresh_folder, **FOLDER_OF_PRESSES},
    "save_result": {"path": FOLDER / "result.npz"},
    "Scale": {"sigma": 0.001, "source": "two marks"},
    "scale_from_points": {"distance_mm": 7.0},
    "scale_from_profile": {"name": "digit"},
    "scale_from_stage": {"distance_mm": 0.8},
    "View": {"frame_shape": SHAPE},
    "view_from_grid": {"kind": "dots", "background": np.full_like(GRID, GRID.max())},
}  # fmt: skip


def all_frames(source: Any) -> int:
    with source:
        return sum(1 for _, _ in zip(range(2), source))


# What shows whether something was rightly made: its use.
USES: dict[str, Callable[[Any], Any]] = {
    "calibrate": lambda calibration: gelform.Reconstructor(calibration)(IMAGE),
    "ChangeSettings": lambda settings: gelform.color_change_from_image(IMAGE, REST, settings),
    "Frame": lambda frame: gelform.Reconstructor(CALIBRATION)(frame),
    "Lens": lambda lens: gelform.image_from_frame(IMAGE, gelform.View(SHAPE, lens=lens)),
    "open_source": all_frames,
    "Reconstructor": lambda reconstruct: reconstruct(IMAGE),
    "registration_from_image": lambda registration: registration.shift_px,
    "track": list,
    "View": lambda view: gelform.image_from_frame(IMAGE, view),
}


def parameters_of(name: str) -> dict[str, inspect.Parameter]:
    """What a function takes, as its signature says; what only reports is left out."""
    return {k: p for k, p in inspect.signature(EXPORTS[name]).parameters.items() if k != "progress"}


def right_arguments(name: str) -> dict[str, Any]:
    """Of a function, those that it needs and those of its options that have a right value here."""
    values = VALUES | OTHERS.get(name, {})
    return {one: values[one] for one in parameters_of(name) if one in values}


def called(name: str, arguments: dict[str, Any]) -> Any:
    """What a function makes of the arguments, and what its use makes of that."""
    made = EXPORTS[name](**{k: v() if v is fresh_folder else v for k, v in arguments.items()})
    return USES[name](made) if name in USES else made
