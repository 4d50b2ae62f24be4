"""Every public function with valid arguments; the tests replace them one by one with invalid ones."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import gelform
from gelform.calibration.presses.folder import with_crosstalk, with_view
from gelform.calibration.starters import load_starter
from gelform.depth.integrate import edge_residuals
from gelform.depth.regions import contacts_from_mask
from gelform.exchange.exporters.press_folder import save_press_folder
from gelform.exchange.plots import save_picture
from gelform.foundations.filters import fill_unknown
from gelform.image.background import ChangeSettings, image_from_color_change
from gelform.image.light import light_from_image
from gelform.image.markers.follower import MarkerFollower
from gelform.image.view import Lens, frame_from_image
from gelform.result.metrics import press_errors
from gelform.sensors.files import read_background
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
SIGMA = np.full((*SHAPE, 2), 0.05, np.float32)
PITCH = {"mm_per_px": MM_PER_PX}
RESULT = gelform.Reconstructor(calibration())(IMAGE)
FRAME = gelform.Frame(IMAGE, 0.0, 0, 0)
LIGHT = load_starter("gelsight-mini").calibration.background
SCALE = gelform.Scale(0.1, 0.001, "two marks")
FOLDER_OF_PRESSES = {
    "background": UNTOUCHED, "images": [IMAGE, IMAGE], "ball_diameters_mm": [8.0, 8.0], "name": "known gel",
    "centers_px": [(40.0, 30.0)] * 2, "contact_radii_px": [17.0, 17.0], **PITCH,
}  # fmt: skip
PRESSES = gelform.read_presses(save_press_folder(FOLDER / "presses", **FOLDER_OF_PRESSES))

DOTS = np.array([[0.0, 0], [2, 0], [0, 2], [2, 2]])
TOUCHES = [gelform.touch_from_dots(DOTS, k * np.ones((4, 2))) for k in (0.1, 0.2, 0.5)]
LOADS = [gelform.Load("ball", shear_n=(k, k)) for k in (0.1, 0.2, 0.5)]
FORCE = gelform.calibrate_force(TOUCHES, LOADS)


def gain(image: Any, background: Any) -> np.ndarray:
    return light_from_image(image, background).gain


def registered(image: Any, background: Any, touched: Any) -> np.ndarray:
    return gelform.registration_from_image(image, background, touched).shift_px


def saved_presses(**arguments: Any) -> Path:
    return save_press_folder(Path(tempfile.mkdtemp(dir=FOLDER)), **arguments)


def saved_result(result: Any) -> None:
    gelform.save_result(result, FOLDER / "result.npz", overwrite=True)


def saved_picture(picture: Any) -> None:
    save_picture(FOLDER / "picture.png", picture, overwrite=True)


def all_frames(spec: Any) -> int:
    with gelform.open_source(spec) as source:
        return sum(1 for _, _ in zip(range(2), source))


DOORS: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "image_from_frame": (gelform.image_from_frame, {"frame": IMAGE, "view": gelform.View()}),
    "color_change_from_image": (gelform.color_change_from_image, {"image": IMAGE, "background": REST}),
    "image_from_color_change": (image_from_color_change, {"color_change": CHANGE, "background": REST}),
    "light_from_image": (gain, {"image": IMAGE, "background": REST}),
    "background_from_frames": (gelform.background_from_frames, {"frames": [IMAGE, IMAGE, IMAGE]}),
    "markers_from_image": (gelform.markers_from_image, {"image": IMAGE, "background": REST}),
    "MarkerFollower": (MarkerFollower, {"background": REST}),
    "MarkerTracker": (gelform.MarkerTracker, {"background": REST}),
    "registration_from_image": (registered, {"image": IMAGE, "background": REST, "touched": MASK}),
    "normals_from_image": (gelform.normals_from_image, {"image": NORMALS @ LIGHTS.T, "lights": LIGHTS}),
    "image_from_normals": (gelform.image_from_normals, {"normals": NORMALS, "lights": LIGHTS, "albedo": WEIGHTS}),
    "lights_from_normals": (
        gelform.lights_from_normals,
        {"image": np.maximum(NORMALS @ LIGHTS.T, 0), "normals": NORMALS, "albedo": WEIGHTS},
    ),
    "normals_from_gradients": (gelform.normals_from_gradients, {"gradients": GRADIENTS}),
    "gradients_from_normals": (gelform.gradients_from_normals, {"normals": NORMALS}),
    "smoothed_gradients": (gelform.smoothed_gradients, {"gradients": GRADIENTS, "texture": 0.02}),
    "gradients_from_depth": (gelform.gradients_from_depth, {"depth_mm": DEPTH, **PITCH}),
    "depth_from_gradients": (gelform.depth_from_gradients, {"gradients": GRADIENTS, **PITCH}),
    "integrate": (
        gelform.integrate,
        {"gradients": GRADIENTS, **PITCH, "weights": WEIGHTS, "mask": MASK, "anchor": WEIGHTS, "zero": MASK},
    ),
    "edge_residuals": (edge_residuals, {"depth_mm": DEPTH, "gradients": GRADIENTS, **PITCH}),
    "contact_from_depth": (gelform.contact_from_depth, {"depth_mm": DEPTH, **PITCH}),
    "curl_from_gradients": (gelform.curl_from_gradients, {"gradients": GRADIENTS, **PITCH}),
    "fill_unknown": (fill_unknown, {"values": GRADIENTS, "known": MASK}),
    "frame_from_image": (frame_from_image, {"image": IMAGE, "view": gelform.View(SHAPE, flip="x")}),
    "contacts_from_mask": (contacts_from_mask, {"contact": MASK, "depth": DEPTH, **PITCH}),
    "press_errors": (
        press_errors,
        {"depth_mm": DEPTH, "gradients": GRADIENTS, "circle_px": (40.0, 30.0, 17.0), "ball_radius_mm": 4.0, **PITCH},
    ),
    "Scale": (gelform.Scale, {"mm_per_px": 0.1, "sigma": 0.001, "source": "two marks"}),
    "combined_scale": (gelform.combined_scale, {"scales": [SCALE, SCALE]}),
    "scale_from_profile": (gelform.scale_from_profile, {"name": "digit"}),
    "scale_from_points": (
        gelform.scale_from_points,
        {"a_px": (3.0, 4.0), "b_px": (60.0, 50.0), "distance_mm": 7.0, "sigma_px": 0.5, "sigma_mm": 0.01},
    ),
    "scale_from_stage": (
        gelform.scale_from_stage,
        {"first": IMAGE, "second": image_of(Touch(x_px=48)), "background": REST, "distance_mm": 0.8, "sigma_mm": 0.01},
    ),
    "crosstalk_from_frames": (
        gelform.crosstalk_from_frames, {"frames": [UNTOUCHED] * 3, "dark": IMAGE // 9, "response": 1.0}
    ),
    "view_from_grid": (
        gelform.view_from_grid,
        {"images": [IMAGE], "pattern": (5, 4), "pitch_mm": 1.0, "kind": "dots", "pitch_sigma_mm": 0.01},
    ),
    "calibration_from_background": (
        gelform.calibration_from_background,
        {"background": LIGHT, "sensor": "gelsight-mini", "mm_per_px": 0.0634, "serial": "A", "gel_id": "g"},
    ),
    "import_calibration": (
        gelform.import_calibration,
        {"path": "nowhere.pth", "package": "gs_sdk", "background": REST, "mm_per_px": 0.1, "sensor_name": "x"},
    ),
    "read_image": (gelform.read_image, {"path": "nowhere.png"}),
    "read_background": (read_background, {"paths": "nowhere.png"}),
    "load_calibration": (gelform.load_calibration, {"path": "nowhere.npz"}),
    "load_result": (gelform.load_result, {"path": "nowhere.npz"}),
    "Video": (gelform.Video, {"path": "nowhere.avi"}),
    "open_source": (all_frames, {"spec": "nowhere"}),
    "read_presses": (gelform.read_presses, {"path": FOLDER / "presses", "mm_per_px": 0.1, "sensor": None, "crop": None}),
    "presses_from_frames": (
        gelform.presses_from_frames,
        {"frames": [FRAME] * 3, "ball_diameter_mm": 8.0, **PITCH, "background": REST, "name": "x"},
    ),
    "with_scale": (gelform.with_scale, {"presses": PRESSES, "scale": SCALE}),
    "with_view": (with_view, {"presses": PRESSES, "view": gelform.View(), "source": "a grid"}),
    "with_crosstalk": (with_crosstalk, {"presses": PRESSES, "crosstalk": None}),
    "evaluate": (gelform.evaluate, {"calibration": calibration(), "presses": PRESSES}),
    "calibrate": (gelform.calibrate, {"presses": PRESSES, "color_model": "lambertian", "start": None}),
    "motion_between": (gelform.motion_between, {"a": RESULT, "b": RESULT, "start": np.eye(4), "prior": (0.1, 0.1)}),
    "track": (lambda **s: list(gelform.track(**s)), {"results": [RESULT, RESULT], "prior": (0.1, 0.1)}),
    "mosaic": (gelform.mosaic, {"results": [RESULT, RESULT], "poses": [np.eye(4), np.eye(4)]}),
    "touch_from_result": (gelform.touch_from_result, {"result": RESULT}),
    "touch_from_dots": (gelform.touch_from_dots, {"rest_mm": DOTS, "displacement_mm": 0.1 * DOTS}),
    "force_from_result": (gelform.force_from_result, {"result": TOUCHES[0], "model": FORCE}),
    "calibrate_force": (gelform.calibrate_force, {"presses": TOUCHES, "loads": LOADS, "sure_of_unit": True}),
    "evaluate_force": (gelform.evaluate_force, {"model": FORCE, "presses": TOUCHES, "loads": LOADS}),
    "read_loads": (gelform.read_loads, {"path": "nowhere", "calibration": calibration(), "background": None}),
    "picture": (gelform.picture, {"result": RESULT, "image": IMAGE}),
    "save_picture": (saved_picture, {"picture": IMAGE}),
    "save_result": (saved_result, {"result": RESULT}),
    "save_press_folder": (saved_presses, FOLDER_OF_PRESSES),
    "Lens": (
        lambda **s: gelform.image_from_frame(IMAGE, gelform.View(SHAPE, lens=Lens(**s))),
        {
            "camera": (80.0, 80.0, 40.0, 32.0),
            "distortion": (0.01, 0.0, 0.0, 0.0),
            "perspective": (1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0),
        },
    ),
    "Frame": (lambda **s: gelform.Reconstructor(calibration())(gelform.Frame(**{**vars(FRAME), **s})), {"image": IMAGE}),
    "Reconstructor": (lambda frame: gelform.Reconstructor(calibration())(frame), {"frame": IMAGE}),
}  # fmt: skip

SETTINGS = {
    "integrate": (
        lambda **s: gelform.integrate(GRADIENTS, mm_per_px=MM_PER_PX, **s),
        ("solver", "zero", "level", "weights", "anchor", "mask"),
    ),
    "contact_from_depth": (
        lambda **s: gelform.contact_from_depth(DEPTH, mm_per_px=MM_PER_PX, **s),
        ("depth_sigma_mm", "relaxation_mm", "noise_factor", "min_area_mm2"),
    ),
    "MarkerFollower": (lambda **s: MarkerFollower(REST, **s), ("mm_per_px",)),
    "read_presses": (
        lambda **s: gelform.read_presses(FOLDER / "presses", **s), ("mm_per_px", "ball_diameter_mm")
    ),
    "color_change_from_image": (lambda **s: gelform.color_change_from_image(IMAGE, REST, **s), ("settings",)),
    "ChangeSettings": (
        lambda **s: gelform.color_change_from_image(IMAGE, REST, ChangeSettings(**s)),
        ("method", "offset", "blur_px", "crosstalk", "response"),
    ),
    "View": (
        lambda **s: gelform.image_from_frame(IMAGE, gelform.View(**{"frame_shape": SHAPE, **s})),
        ("frame_shape", "crop", "flip", "image_shape", "lens"),
    ),
    "Reconstructor": (
        lambda **s: gelform.Reconstructor(**{"calibration": calibration(), **s})(IMAGE),
        ("calibration", "background", "solver"),
    ),
}  # fmt: skip

# Of modules below gelform, beside its own names.
DEEPER = {
    one.__name__: one
    for one in (
        ChangeSettings,
        contacts_from_mask,
        edge_residuals,
        light_from_image,
        fill_unknown,
        frame_from_image,
        image_from_color_change,
        Lens,
        MarkerFollower,
        press_errors,
        read_background,
        save_picture,
        save_press_folder,
        with_crosstalk,
        with_view,
    )
}

# What no argument of a user's goes into: records of results, made by the functions above, and a Protocol.
RECORDS = (
    "Calibration",
    "Contact",
    "ForceModel",
    "Frame",
    "Integration",
    "Load",
    "Motion",
    "Reconstruction",
    "Stream",
    "Tracked",
)
# Tried with nothing right at all: what is right is long to make, or a thread.
ALL_ODD = ("save_simulated_presses", "Grabber", "stream")
