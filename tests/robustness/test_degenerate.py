"""Input that leaves something undetermined, at the public doors: the same outcome whatever the processor rounds to.

Motion has its own such input in `motion/test_between.py`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.calibration.circles.find import find_contact
from hostile.doors import (
    CHANGE,
    DOORS,
    FOLDER_OF_PRESSES,
    FORCE,
    IMAGE,
    REST,
    RESULT,
    UNTOUCHED,
    saved_presses,
)
from hostile.outcome import judge
from made.dots import image_of_dots
from made.small_gel import MM_PER_PX, SHAPE, Touch, calibration, image_of, stepping

pytestmark = pytest.mark.linear_algebra
FLAT = np.full((*SHAPE, 3), 128, np.uint8)
RAMP = np.broadcast_to(np.linspace(60, 200, SHAPE[1])[None, :, None], FLAT.shape).astype(np.uint8)
ONE_PIXEL = FLAT.copy()
ONE_PIXEL[30, 40] = 255
IMAGES = {
    "flat": (FLAT, FLAT), "black": (0 * FLAT, 0 * FLAT), "one frame twice": (IMAGE, IMAGE), "one pixel": (ONE_PIXEL, FLAT),
    "gray": (IMAGE[..., :1].repeat(3, 2), REST[..., :1].repeat(3, 2)), "a ramp": (RAMP, RAMP), "flat now": (FLAT, REST),
    "2 px": (IMAGE[:2, :2], REST[:2, :2]), "25 rows": (IMAGE[:25], REST[:25]),
    "a row": (IMAGE[30:31], REST[30:31]), "a column": (IMAGE[:, 40:41], REST[:, 40:41]),
}  # fmt: skip
OUTCOMES = {
    "markers_from_image": {},
    "light_from_image": {},
    "color_change_from_image": {},
    "registration_from_image": {"a row": "error", "a column": "error"},
}
FRAMES = dict.fromkeys(
    ("flat", "black", "one frame twice", "flat now", "a ramp", "a row", "a column"), "finding"
)
FRAMES |= {"one pixel": "right", "2 px": "right"}
MORE = {"registration_from_image": {"touched": None}}
LINES = {
    "a row": (1.0, 0.0),
    "a slanted line": (0.1, 0.37),
    "a line far away": (1 / 3, 1 / 7),
    "one place": (0.0, 0.0),
}
TIMES = np.linspace(0.1, 1, 12)
PUSHED = [
    gelform.touch_from_dots(np.array([[0.0, 0], [2, 0], [0, 2], [2, 2]]), k * np.ones((4, 2))) for k in TIMES
]
ODD_LOADS = {
    "huge": (1e300, 1e300), "infinite": (np.inf, 1.0), "NaN": (np.nan, 1.0), "of three parts": (1.0, 2.0, 3.0),
    "a number": 1.0, "words": ("a", "b"), "nested": [[1, 2]], "one part": (1.0,),
}  # fmt: skip
PLACES = {"one place": [(40, 30)] * 6, "the border": [(0, 30), (79, 30), (40, 0), (40, 63), (0, 0), (79, 63)]}


def calibrated(images: list[np.ndarray], rest: np.ndarray = UNTOUCHED) -> gelform.Calibration:
    presses = {
        **FOLDER_OF_PRESSES, "background": rest, "images": images, "ball_diameters_mm": [8.0] * len(images),
        "centers_px": None, "contact_radii_px": None,
    }  # fmt: skip
    return gelform.calibrate(
        gelform.read_presses(saved_presses(**presses), mm_per_px=MM_PER_PX), color_model="lambertian"
    )


@pytest.mark.parametrize("what", IMAGES)
@pytest.mark.parametrize("name", OUTCOMES)
def test_an_image_that_shows_nothing(name, what):
    image, rest = IMAGES[what]
    asked = {"image": image, "background": rest.astype(np.float32)}
    assert judge(f"{name} of {what}", lambda: DOORS[name][0](**asked, **MORE.get(name, {}))) == OUTCOMES[
        name
    ].get(what, "right")


@pytest.mark.parametrize("what", FRAMES)
@pytest.mark.parametrize("known", [calibration, stepping])
def test_a_frame_that_shows_nothing(known, what):
    image, rest = IMAGES[what]
    seen = replace(known(), background=rest.astype(np.float32), image_shape=rest.shape[:2])
    assert judge(what, lambda: gelform.Reconstructor(seen)(image)) == FRAMES[what]


@pytest.mark.parametrize("rows", [1, 2, 4, 10])
def test_a_motion_of_the_camera_by_a_few_rows(rows):
    """Those do not determine how light changes down the image."""
    touched = np.ones(SHAPE, bool)
    touched[30 : 30 + rows] = False
    assert judge("registered", lambda: gelform.registration_from_image(IMAGE, REST, touched)) == "right"


@pytest.mark.parametrize("what", LINES)
def test_dots_in_a_line_tell_no_tilt(what):
    along = np.arange(6.0)[:, None] * LINES[what] + (1 / 3, 1e3)
    assert judge(what, lambda: gelform.touch_from_dots(along, 0.1 * np.sin(along))) == "error"
    image = image_of_dots(12 * (along - along[0]) + 12)
    assert judge(what, lambda: gelform.markers_from_image(image, image.astype(np.float32))) == "right"


@pytest.mark.parametrize("what", ODD_LOADS)
def test_loads_that_are_no_numbers(what):
    loads = [gelform.Load("ball", shear_n=ODD_LOADS[what])] * len(TIMES)
    assert judge(what, lambda: gelform.calibrate_force(PUSHED, loads)) == "error"
    assert judge(what, lambda: gelform.evaluate_force(FORCE, PUSHED, loads)) == "error"


@pytest.mark.parametrize("touches", [PUSHED, PUSHED[:1] * len(TIMES)])
def test_forces_of_dots_that_do_not_turn(touches):
    """Turn and tilt determine nothing; nor does one motion alone."""
    loads = [gelform.Load("ball", shear_n=(k, k)) for k in TIMES]
    model = gelform.calibrate_force(touches, loads)
    assert np.abs(model.shear.weights).max() < 10
    assert np.abs(np.array(model.shear.weights)[:, 2:]).max() < 1e-9


@pytest.mark.parametrize("what", ["flat", "constant", *PLACES])
def test_presses_that_determine_no_calibration(what):
    constant = [np.full_like(UNTOUCHED, 100 + k) for k in range(6)]
    images = {"flat": [image_of(None)] * 6, "constant": constant} | {
        name: [image_of(Touch(x_px=x, y_px=y, seed=k)) for k, (x, y) in enumerate(places)]
        for name, places in PLACES.items()
    }
    rest = constant[0] if what == "constant" else UNTOUCHED
    if what == "the border":  # half of each ball is enough, around the whole frame
        assert calibrated(images[what], rest).held_out["normal_free_deg"] < 1.5
        return
    assert judge(what, lambda: calibrated(images[what], rest)) == "error"


@pytest.mark.parametrize("shape", [(1, 80), (64, 1), (10, 80)])
def test_images_without_room_for_a_contact(shape):
    small = CHANGE[: shape[0], : shape[1]]
    with pytest.raises(gelform.GelformError, match=f"at least 24 px .* got {shape[0]}x{shape[1]} px"):
        find_contact(small)


def test_a_mosaic_of_results_without_contact():
    none = replace(RESULT, contact=np.zeros(SHAPE, bool))
    assert judge("mosaic", lambda: gelform.mosaic([none, none], [np.eye(4)] * 2)) == "error"


@pytest.mark.parametrize("scale", [1.0, 1e3, 1e-5])
def test_a_perspective_that_cannot_be_undone(scale):
    """Its determinant is a rounding error, which is no measure by itself."""
    flattened = scale * np.array([[0.1, 0.7, 0], [0.3, 2.1, 0], [0, 0, 1]])
    door, asked = DOORS["Lens"]
    assert judge("flattened", lambda: door(**{**asked, "perspective": tuple(flattened.ravel())})) == "error"
    assert (
        judge("level", lambda: door(**{**asked, "perspective": tuple((scale * np.eye(3)).ravel())}))
        == "right"
    )
