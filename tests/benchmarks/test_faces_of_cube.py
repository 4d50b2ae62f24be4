"""The border of a cube's faces is found in the color alone: of even faces whose color decays beside them."""

import numpy as np
import pytest

import faces_of_cube
from edges_of_cube import DATA

SHAPE = (160, 240)
COLORS = np.array([[60.0, -30, 10], [-40, 10, 50]])  # gray levels of the change of both faces


def cube(widths_px, light=1.0, top=80.0):
    """Image, background and faces of an edge along x, whose faces' widths grow by a tenth of it, and the edge's ends."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    background = rng.uniform(90, 110, (*SHAPE, 3))
    change, faces = np.zeros((*SHAPE, 3)), np.zeros(SHAPE, bool)
    for sign, width, color in zip((1, -1), widths_px, COLORS):
        away, border = sign * (y - top), width + 0.1 * (x - 120)
        beyond = np.maximum(away - border, 0) + np.maximum(np.abs(x - 120) - 80, 0)
        change += (away > 0)[..., None] * color * np.exp(-beyond / 8)[..., None]
        faces |= (away > 0) & (away < border) & (np.abs(x - 120) < 80)
    image = light * (background + change) + rng.normal(0, 1, change.shape)
    return (
        np.clip(image, 0, 255).astype(np.uint8),
        background,
        faces,
        np.array([(40, top + 3), (200, top - 3)]),
    )


@pytest.mark.parametrize(("widths", "light"), [((20, 20), 1.0), ((12, 24), 1.0), ((20, 20), 1.12)])
def test_faces_end_where_their_color_begins_to_decay(widths, light):
    image, background, faces, ends = cube(widths, light)
    found = faces_of_cube.touched_faces(image, background, ends)
    assert np.count_nonzero(found & faces) / np.count_nonzero(found | faces) > 0.9


def test_what_lies_outside_of_the_frame_is_no_color_of_a_face():
    image, background, faces, ends = cube(
        (30, 20), top=120.0
    )  # a face whose border is 10 px from the frame's
    found = faces_of_cube.touched_faces(image, background, ends)
    assert np.count_nonzero(found & faces) / np.count_nonzero(found | faces) > 0.9


def test_marks_are_moved_onto_the_edge():
    image, background, _, ends = cube((20, 20))
    moved = faces_of_cube.sharpest((image - background).astype(np.float32), ends.astype(float))
    np.testing.assert_allclose(moved[:, 1], 80, atol=0.8)


def test_every_marked_frame_exists(data):
    assert all((DATA / "mini-edge" / "images" / name).is_file() for name in faces_of_cube.ENDS)
